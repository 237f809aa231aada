"""Image sensors: networks that other distributions bring, and that say where a target is in an
image.

A distribution names its class in its ``pyproject.toml``; nothing else of the core knows it::

    [project.entry-points."dynahoi_lerobot.sensors"]
    eye = "lerobot_policy_obact.eye.sensor:EyeSensor"

    [project.entry-points."dynahoi_lerobot.sensor_trainings"]
    eye = "lerobot_policy_obact.eye.pretraining:Training"
"""

from importlib.metadata import entry_points
from typing import Any, ClassVar, Protocol

import numpy as np

from dynahoi_lerobot.core.registry import known

GROUP = "dynahoi_lerobot.sensors"
TRAINING_GROUP = "dynahoi_lerobot.sensor_trainings"


class ImageSensor(Protocol):
    """What an entry point in ``GROUP`` names: called with a view, it returns one for its images.

    Attributes:
        names: of the D numbers of a sighting.
        image_px: side of the images that it has learned from [px].
    """

    names: ClassVar[tuple[str, ...]]
    image_px: ClassVar[int]

    def see(self, images: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Return sightings (F, D) float32 in images (F, H, W, 3) uint8 RGB.

        ``before`` are those one frame earlier; the first of an episode stands before itself.
        `dynahoi encode` calls it from several threads at once.
        """
        ...

    @staticmethod
    def place(
        sightings: np.ndarray, pose: np.ndarray, intrinsics: np.ndarray, *, carried: bool
    ) -> np.ndarray:
        """Return where sightings (F, D) of a camera are [m], (F, 3), along the axes of the world.

        They count from the palm if the hand carries the camera, else from where the palm waits.

        Args:
            sightings: what ``see`` returned.
            pose: of the camera, (7,), see `Pinhole.pose`.
            intrinsics: of the camera, (4,) [px].
            carried: whether the hand carries it.
        """
        ...


def image_sensor(name: str) -> Any:
    """Return the class of the `ImageSensor` that an installed distribution brings under a name.

    Raises:
        ValueError: if none does, or it cannot be imported.
    """
    return _brought(GROUP, name)


def sensor_training(name: str) -> Any:
    """Return what trains an image sensor: a class that takes a recipe of `dynahoi pretrain`.

    Raises:
        ValueError: if no installed distribution brings it, or it cannot be imported.
    """
    return _brought(TRAINING_GROUP, name)


def _brought(group: str, name: str) -> Any:
    found = {entry.name: entry for entry in entry_points(group=group)}
    if not found:
        raise ValueError(f"no installed package brings {name!r}: install lerobot_policy_obact")
    try:
        return known("image sensor", name, found).load()
    except ImportError as error:
        raise ValueError(f"the image sensor {name!r} cannot be used: {error}") from error
