"""Where the fingertips of all worlds are, and how far from the target's surface."""

from __future__ import annotations

import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.foundation.conventions import FINGERS
from dynahoi_lerobot.foundation.rotations import matrix_to_rotvec
from dynahoi_lerobot.scene.scene import Scene
from dynahoi_lerobot.scene.signed_distance import signed_distance
from dynahoi_lerobot.scene.world_fields import WorldFields


class Fingertips:
    """Reads the five fingertips of N worlds from a batch whose kinematics are up to date."""

    def __init__(self, scene: Scene, batch: Batch, fields: WorldFields) -> None:
        """Bind the poses of geoms and sites of ``batch``."""
        self._scene, self._fields = scene, fields
        self._geom_pos, self._geom_mat = batch.bind("geom_xpos"), batch.bind("geom_xmat")
        self._site_pos, self._site_mat = batch.bind("site_xpos"), batch.bind("site_xmat")
        self._distance: np.ndarray | None = None

    def forget(self) -> None:
        """Drop the measured distances, because something has moved."""
        self._distance = None

    def poses(self, origin_w: np.ndarray) -> np.ndarray:
        """Return (N, 30), position [m] and rotation vector [rad] of each fingertip.

        Args:
            origin_w: (N, 3) from where positions are counted [m], world.
        """
        position = self._site_pos[:, self._scene.tip_sites] - origin_w[:, None]  # (N, 5, 3)
        rotation = self._site_mat[:, self._scene.tip_sites].reshape(*position.shape, 3)  # (N, 5, 3, 3)
        return np.concatenate([position, matrix_to_rotvec(rotation)], axis=-1).reshape(len(position), -1)

    def target_distance(self) -> np.ndarray:
        """Return (N, 5), signed distance of each fingertip to the target's surface [m], negative inside.

        Experts, recordings and contacts ask for the same one, so it is kept until ``forget``.
        """
        if self._distance is None:
            self._distance = self._measure()
        return self._distance

    def _measure(self) -> np.ndarray:
        tips = self._site_pos[:, self._scene.tip_sites]  # (N, 5, 3)
        nearest = np.full((len(tips), len(FINGERS)), np.inf)
        alpha, sizes = self._fields.fields["geom_rgba"][..., 3], self._fields.fields["geom_size"]
        for shape, ids in self._scene.slots.items():
            geoms = np.asarray(ids)  # (S,)
            offset = tips[:, :, None] - self._geom_pos[:, None, geoms]  # (N, 5, S, 3)
            rotation = self._geom_mat[:, geoms].reshape(len(tips), 1, len(geoms), 3, 3)
            local = (rotation * offset[..., None]).sum(axis=-2)  # transposed rotation times offset
            distance = signed_distance(shape, local, np.broadcast_to(sizes[:, None, geoms], local.shape))
            hidden = (alpha[:, geoms] == 0.0)[:, None]
            nearest = np.minimum(nearest, np.where(hidden, np.inf, distance).min(axis=2))
        return nearest
