"""The cameras of the model as pinholes: where in its image a camera sees a place."""

from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np

from dynahoi_lerobot.core.numerics import quat_to_matrix, tan


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A camera with square images, in the frame of the body that it is fixed to.

    The hand's camera is fixed to the palm, which does not turn and has its origin at the palm
    center; the side camera to a body that is put where the palm center waits.

    Attributes:
        pos_m: (3,) [m].
        quat: (4,) wxyz; the camera looks along its -z, with y up.
        half_view: tangent of half its field of view.
    """

    pos_m: np.ndarray
    quat: np.ndarray
    half_view: float

    @classmethod
    def of(cls, model: mujoco.MjModel, camera: str) -> Self:
        """Return the model's camera of this name."""
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
        half_view = float(tan(np.radians(float(model.cam_fovy[number])) / 2))
        return cls(model.cam_pos[number].copy(), model.cam_quat[number].copy(), half_view)

    @property
    def pose(self) -> np.ndarray:
        """(7,) position [m] and quaternion wxyz."""
        return np.concatenate([self.pos_m, self.quat])

    @property
    def axes(self) -> np.ndarray:
        """(3, 3) the directions to the right, upwards and backwards as columns."""
        return quat_to_matrix(self.quat)

    def intrinsics(self, image_size: int) -> np.ndarray:
        """Return (4,) focal lengths fx and fy and principal point cx and cy [px] in images of that
        side [px].

        The center of the first pixel is at (0.5, 0.5).
        """
        half = image_size / 2
        focal = half / self.half_view
        return np.array([focal, focal, half, half])

    def project(self, offset_m: np.ndarray) -> np.ndarray:
        """Return (..., 3) where a place is seen: to the right and upwards, both -1 to 1 within the
        image, and its depth [m].

        Args:
            offset_m: (..., 3) from the camera, along the axes of its body [m].
        """
        local = offset_m @ self.axes
        depth = -local[..., 2:]
        return np.concatenate([local[..., :2] / (depth * self.half_view), depth], axis=-1)
