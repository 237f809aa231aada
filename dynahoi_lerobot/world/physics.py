"""One control step of physics, 25 steps at 500 Hz, in which targets are driven until a capture
rule's event.
"""

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.captures import NO_EVENT, CaptureRule
from dynahoi_lerobot.core.conventions import PALM_DOF, SUBSTEPS
from dynahoi_lerobot.core.numerics import quat_to_matrix
from dynahoi_lerobot.scene.contact_sensors import TargetContacts, no_contacts, read_contacts
from dynahoi_lerobot.scene.scene import Scene
from dynahoi_lerobot.scene.world_fields import WorldFields

CONTROL_SPEC = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)


class Physics:
    """Advances worlds, and keeps what a capture rule and a recording need to know of the last
    control step.

    Attributes:
        palm_distance_m: (N,) [m], least distance of palm and target center during the last control
            step.
        localized: (N,) bool, the target has been localized in the control phase.
        released: (N,) bool, the capture rule's event has happened: nothing drives the target any
            more.
        contacts: of shape (N,), what touched the target during the last control step: mean forces
            [N] and mean numbers of contacts. Zero if the capture rule uses no contact sensors.
    """

    def __init__(self, scene: Scene, batch: Batch, fields: WorldFields, rule: CaptureRule) -> None:
        self._scene = scene
        self._batch = batch
        self._fields = fields
        self._rule = rule
        self.n_controls = scene.model.nu
        self.palm_distance_m = np.full(batch.nsim, np.inf)
        self.localized, self.released = np.zeros((2, batch.nsim), bool)
        self.contacts: TargetContacts = no_contacts(batch.nsim)
        self._force_w: list[np.ndarray] = [np.zeros((0, SUBSTEPS, 3))] * batch.nsim

    def drive(self, i: int, force_w: np.ndarray) -> None:
        """Begin to drive the target of world ``i`` by (F, 25, 3) force [N], world, in each physics
        step of F frames.
        """
        self._force_w[i] = force_w
        self.released[i] = False

    def reset(self, ids: np.ndarray, palm_distance_m: np.ndarray) -> None:
        """Begin an episode in worlds ``ids`` (n,), whose palms are ``palm_distance_m`` (n,) from
        their targets.
        """
        self.palm_distance_m[ids] = palm_distance_m
        self.localized[ids] = False
        for values in (
            self.contacts.finger_force_n,
            self.contacts.palm_force_n,
            self.contacts.others,
        ):
            values[ids] = 0.0

    @property
    def target_pose_h(self) -> np.ndarray:
        """(N, 7) position [m] and quaternion wxyz, world."""
        return self._fields.qpos[:, self._scene.target_qpos : self._scene.target_qpos + 7].copy()

    @property
    def target_velocity_w(self) -> np.ndarray:
        """(N, 6) linear [m/s] and angular [rad/s] velocity, world."""
        dof = self._scene.target_dof
        velocity = self._fields.qvel[:, dof : dof + 6].copy()
        velocity[:, 3:] = (quat_to_matrix(self.target_pose_h[:, 3:]) * velocity[:, None, 3:]).sum(
            axis=-1
        )
        return velocity

    def advance(
        self, ids: np.ndarray, set_points: np.ndarray, frame: np.ndarray, acting: np.ndarray
    ) -> None:
        """Roll one control step; where the capture rule has an event, go back and insert it.

        Args:
            ids: (n,) worlds.
            set_points: (n, 25, nu) of the servos, palm [m] and joints [rad], world.
            frame: (n,) of their episodes, by which targets are driven.
            acting: (n,) bool, the control phase has begun.
        """
        control = self._control(ids, set_points, frame)
        before = self._batch.state[ids].copy()
        palm_distance_m, contacts = self._roll(ids, control)
        self._keep(ids, contacts)
        self.palm_distance_m[ids] = palm_distance_m.min(axis=1)
        self.localized[ids] |= acting & (
            self.palm_distance_m[ids] < self._rule.localization_radius_m
        )
        events = np.where(
            self.released[ids], NO_EVENT, self._rule.events(acting, palm_distance_m, contacts)
        )
        for row in np.flatnonzero(events != NO_EVENT):
            self._batch.state[ids[row]] = before[row]
            self._roll_through_event(int(ids[row]), control[row : row + 1], int(events[row]) + 1)

    def _control(self, ids: np.ndarray, set_points: np.ndarray, frame: np.ndarray) -> np.ndarray:
        """(n, 25, nu + nv) what MuJoCo needs for a control step: set points, and the forces [N]
        that drive targets.
        """
        control = np.zeros((len(ids), SUBSTEPS, self.n_controls + self._scene.model.nv))
        control[..., : self.n_controls] = set_points
        dof = self.n_controls + self._scene.target_dof
        for row, i in enumerate(ids):
            if not self.released[i] and frame[row] < len(self._force_w[i]):
                control[row, :, dof : dof + 3] = self._force_w[i][frame[row]]
        return control

    def _roll_through_event(self, i: int, control: np.ndarray, steps: int) -> None:
        """Roll world ``i`` for ``steps`` physics steps, let the event happen, and finish the
        control step.
        """
        one = np.array([i])
        _, before = self._roll(one, control[:, :steps])
        self.released[i] = True
        self._fields.free_target(i)
        self._fields.set_collisions(i, self._rule.collides_after)
        if self._rule.welds:
            self._weld(i)
        if steps < SUBSTEPS:
            rest = control[:, steps:].copy()
            rest[..., self.n_controls :] = 0.0  # whatever drove the target stops
            _, after = self._roll(one, rest)
            self._keep(one, before, after)

    def _weld(self, i: int) -> None:
        scene = self._scene
        fields = self._fields
        position = fields.qpos[i, scene.target_qpos : scene.target_qpos + 3]
        quat = fields.qpos[i, scene.target_qpos + 3 : scene.target_qpos + 7]
        inverse = np.zeros(4)
        offset = np.zeros(3)
        mujoco.mju_negQuat(inverse, quat)
        mujoco.mju_rotVecQuat(
            offset, fields.qpos[i, scene.hand_qpos[:PALM_DOF]] - position, inverse
        )
        data = fields.fields["eq_data"]
        data[i, scene.weld_eq] = 0.0
        data[i, scene.weld_eq, 3:6] = offset
        data[i, scene.weld_eq, 6:10] = inverse
        data[i, scene.weld_eq, 10] = 1.0
        fields.eq_active[i, scene.weld_eq] = 1
        dof = scene.target_dof
        fields.qvel[i, dof : dof + 3] = fields.qvel[i, scene.hand_dof[:PALM_DOF]]
        fields.qvel[i, dof + 3 : dof + 6] = 0.0

    def _roll(
        self, ids: np.ndarray, control: np.ndarray
    ) -> tuple[np.ndarray, TargetContacts | None]:
        """Roll K physics steps; return the distances (n, K) [m] and contacts of shape (n, K) in
        them.
        """
        sensed = self._rule.uses_contact_sensors
        names = ("qpos", "sensordata") if sensed else ("qpos",)
        record = self._batch.rollout(control.shape[1], control, CONTROL_SPEC, record=names, ids=ids)
        qpos = record["qpos"]
        target = qpos[..., self._scene.target_qpos : self._scene.target_qpos + 3]
        distance = np.linalg.norm(target - qpos[..., self._scene.hand_qpos[:PALM_DOF]], axis=-1)
        return distance, read_contacts(record["sensordata"]) if sensed else None

    def _keep(self, ids: np.ndarray, *parts: TargetContacts | None) -> None:
        """Keep the mean of the contacts in the parts of a control step, of shapes (n, K) with 25
        steps together.
        """
        for name, kept in vars(self.contacts).items():
            steps = [getattr(part, name) for part in parts if part is not None]
            if steps:
                kept[ids] = np.concatenate(steps, axis=1).mean(axis=1)
