"""The interface of a renderer: images, geom ids and depth of chosen worlds of a batch, from one
camera.
"""

from abc import ABC, abstractmethod

import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.core.registry import Registry
from dynahoi_lerobot.scene.scene import Scene

DEFAULT_RENDERER = "tiles"


class Renderer(ABC):
    """Renders one camera in the worlds of a batch whose kinematics are up to date.

    A new renderer is one file with a subclass that is registered under a name; images must not
    depend on the other worlds of the batch.

    Attributes:
        scene: the compiled scene that all worlds share.
        batch: the worlds.
        image_size: side of the square images [px].
        camera: id of the camera in the model.
    """

    def __init__(self, scene: Scene, batch: Batch, image_size: int, camera: str) -> None:
        """Prepare to render ``batch``, of ``scene.model``, from the model's camera of that name;
        see the attributes.
        """
        self.scene = scene
        self.batch = batch
        self.image_size = image_size
        self.camera = scene.model.camera(camera).id

    @abstractmethod
    def rgb(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W, 3) uint8 RGB of worlds ``ids`` (n,)."""

    @abstractmethod
    def segmentation(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) int32 geom ids of worlds ``ids`` (n,), -1 for a miss."""

    @abstractmethod
    def depth(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) float32 depth along the optical axis [m] of worlds ``ids`` (n,), 0 for a
        miss.
        """


RENDERERS: Registry[type[Renderer]] = Registry(
    "renderer",
    Renderer,
    slow={
        "flat": "dynahoi_lerobot.renderers.tiles",
        "tiles": "dynahoi_lerobot.renderers.tiles",
        "warp": "dynahoi_lerobot.renderers.warp",
    },
)
