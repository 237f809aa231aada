"""What a renderer is: N worlds in, N images out."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.scene.scene import Scene

RENDERERS: Registry[type[Renderer]] = Registry("renderer", "dynahoi_lerobot.renderers")
DEFAULT_RENDERER = "tiles"


class Renderer(ABC):
    """Draws one camera of every world of a batch whose kinematics are up to date."""

    def __init__(self, scene: Scene, batch: Batch, image_size: int, camera: str = EGO_CAMERA) -> None:
        """Prepare to draw ``batch``, which runs ``scene.model``, in square images of ``image_size`` pixels."""
        self.scene, self.batch, self.image_size = scene, batch, image_size
        self.camera = scene.model.camera(camera).id

    @abstractmethod
    def rgb(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W, 3) uint8 RGB of worlds ``ids`` (n,)."""

    @abstractmethod
    def segmentation(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) int32 geom ids, -1 where nothing is, of worlds ``ids`` (n,)."""

    @abstractmethod
    def depth(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) float32 depth along the camera's axis [m], 0 where nothing is, of worlds ``ids`` (n,)."""
