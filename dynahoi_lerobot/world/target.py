"""The targets of N worlds: driven along their paths until a capture rule welds or releases them."""

from __future__ import annotations

import mujoco
import numpy as np

from dynahoi_lerobot.captures import Release, Weld
from dynahoi_lerobot.foundation.conventions import PALM_DOF, SUBSTEPS
from dynahoi_lerobot.foundation.rotations import quat_to_matrix
from dynahoi_lerobot.scene.scene import Scene
from dynahoi_lerobot.scene.target_drive import TargetDrive
from dynahoi_lerobot.scene.world_fields import WorldFields


class Targets:
    """Pose, velocity and drive of the target of each world.

    Attributes:
        released: (N,) bool, the capture rule's event has happened: nothing drives the target any more.
    """

    def __init__(self, scene: Scene, fields: WorldFields, size: int) -> None:
        """Serve ``size`` worlds."""
        self._scene, self._fields = scene, fields
        self.released = np.zeros(size, bool)
        self._force_w: list[np.ndarray] = [np.zeros((0, SUBSTEPS, 3))] * size

    def reset(self, i: int, drive: TargetDrive) -> None:
        """Begin to drive the target of world ``i``."""
        self._force_w[i], self.released[i] = drive.force_w, False

    @property
    def pose(self) -> np.ndarray:
        """(N, 7) position [m] and quaternion wxyz, world."""
        return self._fields.qpos[:, self._scene.target_qpos : self._scene.target_qpos + 7].copy()

    @property
    def velocity(self) -> np.ndarray:
        """(N, 6) linear [m/s] and angular [rad/s] velocity, world."""
        dof = self._scene.target_dof
        velocity = self._fields.qvel[:, dof : dof + 6].copy()
        velocity[:, 3:] = (quat_to_matrix(self.pose[:, 3:]) * velocity[:, None, 3:]).sum(axis=-1)
        return velocity

    def force(self, i: int, frame: int) -> np.ndarray:
        """Return (25, 3) the force [N], world, on the target of world ``i`` in each physics step of ``frame``."""
        if self.released[i] or frame >= len(self._force_w[i]):
            return np.zeros((SUBSTEPS, 3))
        return self._force_w[i][frame]

    def apply(self, effect: Weld | Release, i: int) -> None:
        """Do to the target of world ``i`` what a capture rule's event does."""
        self._fields.free_target(i)
        self._fields.set_collisions(i, effect.collides_with if isinstance(effect, Release) else 0)
        self.released[i] = True
        if isinstance(effect, Weld):
            self._weld(i)

    def _weld(self, i: int) -> None:
        scene, fields = self._scene, self._fields
        position = fields.qpos[i, scene.target_qpos : scene.target_qpos + 3]
        quat = fields.qpos[i, scene.target_qpos + 3 : scene.target_qpos + 7]
        inverse, offset = np.zeros(4), np.zeros(3)
        mujoco.mju_negQuat(inverse, quat)
        mujoco.mju_rotVecQuat(offset, fields.qpos[i, scene.hand_qpos[:PALM_DOF]] - position, inverse)
        data = fields.fields["eq_data"]
        data[i, scene.weld_eq] = 0.0
        data[i, scene.weld_eq, 3:6], data[i, scene.weld_eq, 6:10] = offset, inverse
        data[i, scene.weld_eq, 10] = 1.0
        fields.eq_active[i, scene.weld_eq] = 1
        dof = scene.target_dof
        fields.qvel[i, dof : dof + 3] = fields.qvel[i, scene.hand_dof[:PALM_DOF]]
        fields.qvel[i, dof + 3 : dof + 6] = 0.0
