"""Where an image sensor sees the target: what environments show to any policy under
``environment_state=eye``.
"""

import numpy as np

from dynahoi_lerobot.core.features import SIGHTING_AGES, SIGHTING_NAMES
from dynahoi_lerobot.core.image_sensor import ImageSensor
from dynahoi_lerobot.world.frame_history import FrameHistory

DECIMALS = 4
"""Sightings are rounded to 0.1 mm, below which the last bits of a network differ between
processors."""
LEAST_LOG_ERROR = -6.0
GREATEST_LOG_ERROR = 3.0


def eye_state(
    sensor: type[ImageSensor],
    sightings: np.ndarray,
    palm: np.ndarray,
    pose: np.ndarray,
    intrinsics: np.ndarray,
) -> np.ndarray:
    """Return (F, 14) float32 what policies read of F frames: where the target was seen in them and
    some frames before [m], and how sure the last sighting is.

    Before the first frame stands the first.

    Args:
        sensor: that made the sightings; they are a direction, a log depth and the log scales of two
            errors.
        sightings: (F, 5) in images of the hand's camera, one frame after the other.
        palm: (F, 3) palm center position [m], home frame.
        pose: of the camera, (7,), see `Pinhole`.
        intrinsics: of the camera, (4,) [px].
    """
    offset = sensor.place(sightings.astype(np.float32), pose, intrinsics, carried=True)
    place = palm + offset  # (F, 3)
    frame = np.arange(len(place))[:, None] - np.array(SIGHTING_AGES)
    seen = place[frame.clip(min=0)].reshape(len(place), -1)
    scales = sightings[:, 3:].clip(LEAST_LOG_ERROR, GREATEST_LOG_ERROR)
    return np.concatenate([seen, scales], axis=1).round(DECIMALS).astype(np.float32)


class Detector:
    """An image sensor on the images of the hand's camera in N worlds, and what it saw some frames
    ago.

    Before an episode's start stands its first image. Images are encoded one by one, so that what is
    seen in a world does not depend on the others.

    Args:
        sensor: of the view of the hand's camera.
        size: N.
        pose: of the camera, (7,), see `Pinhole`.
        intrinsics: of the camera, (4,) [px].
    """

    def __init__(
        self, sensor: ImageSensor, size: int, pose: np.ndarray, intrinsics: np.ndarray
    ) -> None:
        self._sensor = sensor
        self._pose = pose
        self._intrinsics = intrinsics
        self._images: dict[int, np.ndarray] = {}
        self._seen = FrameHistory(size, SIGHTING_AGES[-1] + 1, (len(sensor.names),))
        self._palms = FrameHistory(size, SIGHTING_AGES[-1] + 1, (3,))
        self._shown = np.zeros((size, len(SIGHTING_NAMES)), np.float32)

    def forget(self, ids: np.ndarray) -> None:
        """Forget the sightings of worlds ``ids`` (n,), whose episodes begin."""
        self._seen.forget(ids)
        self._palms.forget(ids)

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
        for i in ids[frames[ids] != self._seen.frame[ids]]:  # a frame may be observed twice
            image = images[i].copy()
            before = image if self._seen.frame[i] < 0 else self._images[i]
            sighting = self._sensor.see(image[None], before[None])[0]
            self._seen.add(i, sighting, int(frames[i]))
            self._palms.add(i, palm[i], int(frames[i]))
            self._images[i] = image
            seen = self._seen.values[::-1, i]
            palms = self._palms.values[::-1, i]
            states = eye_state(type(self._sensor), seen, palms, self._pose, self._intrinsics)
            self._shown[i] = states[-1]
        return self._shown.copy()
