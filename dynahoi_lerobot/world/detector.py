"""Where an image sensor sees the target: what environments show to any policy under
``environment_state=eye``.
"""

import numpy as np

from dynahoi_lerobot.core.features import SIGHTING_AGES
from dynahoi_lerobot.core.image_sensor import ImageSensor
from dynahoi_lerobot.world.frame_history import FrameHistory

DECIMALS = 4
"""Sightings are rounded to 0.1 mm, below which the last bits of a network differ between
processors."""
LEAST_LOG_ERROR, GREATEST_LOG_ERROR = -6.0, 3.0


class Detector:
    """An image sensor on the images of the hand's camera in N worlds, and what it saw some frames
    ago.

    Before an episode's start stands its first image. Images are encoded one by one, so that what is
    seen in a world does not depend on the others.

    Args:
        sensor: of the view of the hand's camera; its numbers are a direction, a log depth and the
            log scales of two errors.
        size: N.
        pose: of the camera, (7,), see `Pinhole`.
        intrinsics: of the camera, (4,) [px].
    """

    def __init__(
        self, sensor: ImageSensor, size: int, pose: np.ndarray, intrinsics: np.ndarray
    ) -> None:
        self._sensor, self._pose, self._intrinsics = sensor, pose, intrinsics
        self._images: dict[int, np.ndarray] = {}
        self._places = FrameHistory(size, SIGHTING_AGES[-1] + 1, (3,))
        self._scales = np.zeros((size, 2))

    def forget(self, ids: np.ndarray) -> None:
        """Forget the sightings of worlds ``ids`` (n,), whose episodes begin."""
        self._places.forget(ids)

    def see(
        self, images: np.ndarray, palm: np.ndarray, ids: np.ndarray, frames: np.ndarray
    ) -> np.ndarray:
        """Return the sightings of all worlds, (N, 14) float32; worlds that are not among ``ids``
        keep their last.

        Args:
            images: (N, H, W, 3) uint8 RGB.
            palm: (N, 3) palm center position [m].
            ids: (n,) worlds that see.
            frames: (N,) of their episodes.
        """
        for i in ids[frames[ids] != self._places.frame[ids]]:  # a frame may be observed twice
            image = images[i].copy()
            before = image if self._places.frame[i] < 0 else self._images[i]
            sighting = self._sensor.see(image[None], before[None])
            place = self._sensor.place(sighting, self._pose, self._intrinsics, carried=True)[0]
            self._scales[i] = sighting[0, 3:].clip(LEAST_LOG_ERROR, GREATEST_LOG_ERROR)
            self._places.add(i, palm[i] + place, int(frames[i]))
            self._images[i] = image
        seen = self._places.values[SIGHTING_AGES, :].transpose(1, 0, 2).reshape(len(frames), -1)
        return np.concatenate([seen, self._scales], axis=1).round(DECIMALS).astype(np.float32)
