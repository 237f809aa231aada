"""Where ObAct's eye sees the target: what environments show to any policy under
``environment_state=eye``.

This module imports torch and ObAct.
"""

import numpy as np
import torch
from einops import rearrange
from lerobot_policy_obact.camera import Pinhole
from lerobot_policy_obact.encoders import Eye
from lerobot_policy_obact.threads import on_one_thread

from dynahoi_lerobot.core.features import SIGHTING_AGES
from dynahoi_lerobot.world.frame_history import FrameHistory

DECIMALS = 4
"""Sightings are rounded to 0.1 mm, below which the last bits of a network differ between
processors."""


class Detector:
    """The pretrained eye on the images of the hand's camera in N worlds, and what it saw some
    frames ago.

    Before an episode's start stands its first image. Images are encoded one by one, so that what is
    seen in a world does not depend on the others.

    Args:
        size: N.
        pose: of the camera, (7,), see `camera_pose`.
        intrinsics: of the camera, (4,) [px].
    """

    def __init__(self, size: int, pose: np.ndarray, intrinsics: np.ndarray) -> None:
        self._eye = Eye(weights="ego_96").eval()
        self._eye.load_pretrained()
        focal_px, _, centre_px, _ = intrinsics
        self._camera = Pinhole.from_pose(pose.tolist(), centre_px / focal_px, carried=True)
        self._images: dict[int, torch.Tensor] = {}
        self._places = FrameHistory(size, SIGHTING_AGES[-1] + 1, (3,))
        self._scales = np.zeros((size, 2))

    def forget(self, ids: np.ndarray) -> None:
        """Forget what was seen in worlds ``ids`` (n,), whose episodes begin."""
        self._places.forget(ids)

    def see(
        self, images: np.ndarray, palm: np.ndarray, ids: np.ndarray, frames: np.ndarray
    ) -> np.ndarray:
        """Return the sightings of all worlds, (N, 14) float32; worlds that are not among ``ids``
        keep their last.

        Args:
            images: (N, H, W, 3) uint8 RGB.
            palm: (N, 3) palm centre position [m].
            ids: (n,) worlds that see.
            frames: (N,) of their episodes.
        """
        for i in ids[frames[ids] != self._places.frame[ids]]:  # a frame may be observed twice
            image = rearrange(torch.from_numpy(images[i]), "h w c -> 1 c h w") / 255
            place, self._scales[i] = self._sighted(
                image, image if self._places.frame[i] < 0 else self._images[i]
            )
            self._places.add(i, palm[i] + place, int(frames[i]))
            self._images[i] = image
        seen = rearrange(self._places.values[SIGHTING_AGES, :], "a n i -> n (a i)")
        return np.concatenate([seen, self._scales], axis=1).round(DECIMALS).astype(np.float32)

    @on_one_thread
    @torch.inference_mode()
    def _sighted(self, image: torch.Tensor, before: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
        """Return the target's place from the palm [m], (3,), and log scales, (2,); images are (1,
        3, H, W).
        """
        sighting = self._eye(torch.cat([image, before], dim=1))
        return self._camera.place(sighting[:, :3])[0].numpy(), sighting[0, 3:5].clamp(-6, 3).numpy()
