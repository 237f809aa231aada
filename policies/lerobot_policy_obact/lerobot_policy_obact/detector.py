"""Where the eye sees the target: what environments show under ``environment_state=eye``, to policies of any kind."""

from __future__ import annotations

import numpy as np
import torch
from einops import rearrange

from dynahoi_lerobot.core.features import SIGHTING_AGES

from .camera import Pinhole
from .encoders import Eye

DECIMALS = 4
"""Sightings are rounded to 0.1 mm, below which the last bits of a network differ between processors."""


class Detector:
    """The pretrained eye on the images of the hand's camera in N worlds, and what it saw some frames ago.

    Before an episode's start stands its first image. Images are encoded one by one, so that what is seen in a world
    does not depend on the others.

    Args:
        size: N.
        pose: of the camera from the palm, position [m] and quaternion wxyz, (7,).
        half_view: tangent of half its field of view.
    """

    def __init__(self, size: int, pose: np.ndarray, half_view: float) -> None:
        self._eye = Eye(weights="ego_96").eval()
        self._eye.load_pretrained()
        self._camera = Pinhole.from_pose(pose.tolist(), half_view, carried=True)
        self._images: list[torch.Tensor | None] = [None] * size
        self._places = np.zeros((size, SIGHTING_AGES[-1] + 1, 3))  # newest first
        self._scales = np.zeros((size, 2))
        self._frame = np.full(size, -1)  # of each world's newest image

    def forget(self, ids: np.ndarray) -> None:
        """Forget what was seen in worlds ``ids`` (n,), whose episodes begin."""
        self._frame[ids] = -1

    def see(self, images: np.ndarray, palm: np.ndarray, ids: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Return the sightings of all worlds, (N, 14) float32; worlds that are not among ``ids`` keep their last.

        Args:
            images: (N, H, W, 3) uint8 RGB.
            palm: (N, 3) palm centre position [m].
            ids: (n,) worlds that see.
            frames: (N,) of their episodes.
        """
        for i in ids:
            passed = int(frames[i] - self._frame[i])
            if self._frame[i] >= 0 and not passed:  # a frame may be observed twice
                continue
            image = rearrange(torch.from_numpy(images[i]), "h w c -> 1 c h w") / 255
            before = image if self._frame[i] < 0 else self._images[i]
            place, scales = self._sighted(image, image if before is None else before)
            if self._frame[i] < 0:
                self._places[i] = palm[i] + place
            else:
                self._places[i, passed:] = self._places[i, :-passed].copy()
                self._places[i, :passed] = palm[i] + place
            self._images[i], self._scales[i], self._frame[i] = image, scales, frames[i]
        seen = rearrange(self._places[:, SIGHTING_AGES, :], "n a i -> n (a i)")
        return np.concatenate([seen, self._scales], axis=1).round(DECIMALS).astype(np.float32)

    @torch.inference_mode()
    def _sighted(self, image: torch.Tensor, before: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
        """Return the target's place from the palm [m], (3,), and log scales, (2,); images are (1, 3, H, W)."""
        sighting = self._eye(torch.cat([image, before], dim=1))
        return self._camera.place(sighting[:, :3])[0].numpy(), sighting[0, 3:5].clamp(-6, 3).numpy()
