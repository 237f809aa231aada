"""The pretrained eye as a sensor: where it sees the target in the images of a camera.

``dynahoi_lerobot`` finds it by an entry point, for `dynahoi encode` and for environments that show
what it sees.
"""

from typing import ClassVar

import numpy as np
import torch
from einops import rearrange

from ..camera import Pinhole
from ..encoders import EYE_PX, SHIPPED, Eye
from ..threads import on_one_thread


class EyeSensor:
    """The eye that comes with the package for a view.

    Attributes:
        names: of the numbers of a sighting.
        image_px: side of the images that it has learned from.

    Raises:
        ValueError: if no eye comes for that view.
    """

    names: ClassVar[tuple[str, ...]] = (
        "u",
        "v",
        "log_depth",
        "log_error_across",
        "log_error_along",
    )
    image_px: ClassVar[int] = EYE_PX

    def __init__(self, view: str) -> None:
        name = f"{view}_{self.image_px}"
        if name not in SHIPPED:
            known = ", ".join(key.rpartition("_")[0] for key in SHIPPED)
            raise ValueError(f"the eye has not learned from the view {view!r}; known: {known}")
        self._eye = Eye(weights=name).eval()
        self._eye.load_pretrained()

    @on_one_thread
    @torch.inference_mode()
    def see(self, images: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Return sightings ``(F, 5)`` float32: (u, v, log depth) of the target in the camera's
        frame, and the log scales of their errors across and along the line of sight.

        Args:
            images: ``(F, H, W, 3)`` uint8 RGB.
            before: those one frame earlier.
        """
        both = np.concatenate([images, before], axis=-1)
        shown = rearrange(torch.from_numpy(both), "f h w c -> f c h w").float() / 255
        return self._eye(shown).numpy()

    @staticmethod
    def place(
        sightings: np.ndarray, pose: np.ndarray, intrinsics: np.ndarray, *, carried: bool
    ) -> np.ndarray:
        """Return where sightings ``(F, 5)`` are, ``(F, 3)`` [m], along the axes of the world.

        They count from where the camera's pose does.

        Args:
            sightings: as `see` returns them.
            pose: of the camera, position [m] and quaternion wxyz, ``(7,)``.
            intrinsics: of the camera, ``(4,)`` [px].
            carried: whether the hand carries it.
        """
        focal_px, _, center_px, _ = intrinsics
        camera = Pinhole.from_pose(
            [*map(float, pose)], float(center_px / focal_px), carried=carried
        )
        return camera.unproject(torch.from_numpy(sightings[:, :3])).numpy()
