"""The cameras of a batch: a renderer for each one that is used, and the views drawn through them."""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.foundation.conventions import DEFAULT_IMAGE_SIZE_PX
from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.renderers import RENDERERS, Renderer
from dynahoi_lerobot.renderers.camera_views import VIEWS
from dynahoi_lerobot.scene.scene import Scene

RENDER_NOISE = 0x0153
"""Distinguishes the random numbers of the render noise from others of the same seed."""


def with_render_noise(image: np.ndarray, levels: int, seed: int, frame: int, view: str) -> np.ndarray:
    """Return an image (H, W, 3) uint8 whose values have changed by at most ``levels``, as from renderer to renderer.

    The changes are uniform whole numbers, a function of the episode's seed, the frame and the view.
    """
    rng = np.random.default_rng([RENDER_NOISE, seed, frame, zlib.crc32(view.encode())])
    change = rng.integers(-levels, levels, image.shape, np.int16, endpoint=True)
    return np.clip(image + change, 0, 255).astype(np.uint8)


class Cameras:
    """Renders N worlds; a camera costs nothing until something is drawn through it."""

    def __init__(
        self, scene: Scene, batch: Batch, image_size: int, renderer: str, update_kinematics: Callable[[], None]
    ) -> None:
        """Draw ``batch``, which runs ``scene.model``, in square images.

        Args:
            scene: what the worlds share.
            batch: the worlds.
            image_size: side of the images [px]; 0 for the default, where images are drawn only on demand.
            renderer: one of the renderers.
            update_kinematics: recomputes the poses of all worlds; a new renderer asks the batch for further ones.

        Raises:
            UnknownNameError: if there is no such renderer.
        """
        self.image_size = image_size or DEFAULT_IMAGE_SIZE_PX
        self._scene, self._batch, self._update_kinematics = scene, batch, update_kinematics
        self._renderer_class = RENDERERS[renderer]
        self._renderers: dict[str, Renderer] = {}

    def render(self, ids: np.ndarray | None = None, view: str = EGO_CAMERA) -> np.ndarray:
        """Return (N, H, W, 3) uint8 RGB of a view; only worlds ``ids`` (default: all) are drawn, others are black."""
        camera, draw = VIEWS[view]
        n_worlds = self._batch.nsim
        if ids is None or len(ids) == n_worlds:
            return draw(self._renderer(camera), np.arange(n_worlds))
        images = np.zeros((n_worlds, self.image_size, self.image_size, 3), np.uint8)
        if len(ids):
            images[ids] = draw(self._renderer(camera), np.asarray(ids))
        return images

    def segmentation(self) -> np.ndarray:
        """Return (N, H, W) int32 geom ids seen by the hand's camera, -1 where nothing is."""
        return self._renderer(EGO_CAMERA).segmentation(np.arange(self._batch.nsim))

    def depth(self) -> np.ndarray:
        """Return (N, H, W) float32 depth along the axis of the hand's camera [m], 0 where nothing is."""
        return self._renderer(EGO_CAMERA).depth(np.arange(self._batch.nsim))

    def _renderer(self, camera: str) -> Renderer:
        if camera not in self._renderers:
            self._renderers[camera] = self._renderer_class(self._scene, self._batch, self.image_size, camera)
            self._update_kinematics()
        return self._renderers[camera]
