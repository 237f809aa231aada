"""OpenGL through MuJoCo's own renderer, one world after another."""

from __future__ import annotations

import os
import platform
import weakref
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.renderers.base import RENDERERS, Renderer
from dynahoi_lerobot.scene.model import SHOWN_GROUPS
from dynahoi_lerobot.scene.scene import Scene

FLAG = mujoco.mjtRndFlag
OFF = [f.value for f in (FLAG.mjRND_SHADOW, FLAG.mjRND_REFLECTION, FLAG.mjRND_HAZE, FLAG.mjRND_FOG, FLAG.mjRND_SKYBOX)]
"""Effects that are switched off, as the ray casters do not have them."""
ID_COLORS = [FLAG.mjRND_SEGMENT.value, FLAG.mjRND_IDCOLOR.value]
"""Flags that render each object in a flat colour that encodes its id."""
GEOM = mujoco.mjtObj.mjOBJ_GEOM.value


@RENDERERS.register("opengl")
class OpenGLRenderer(Renderer):
    """Loads each world into one MjModel and one MjData and renders it with one OpenGL context.

    Like ``tiles`` it takes one sample per pixel, with textures and without shadows. Shapes and plain colours agree with
    ``tiles``; textures have another phase, and highlights are computed per vertex. EGL is used unless MUJOCO_GL names
    another platform.
    """

    def __init__(self, scene: Scene, batch: Batch, image_size: int, camera: str = EGO_CAMERA) -> None:
        """Open an OpenGL context and upload the textures.

        Raises:
            RuntimeError: if this machine offers no OpenGL; the message says what to do.
        """
        super().__init__(scene, batch, image_size, camera)
        self._model = batch.get_model(0)
        self._data = mujoco.MjData(self._model)
        quality, frame = self._model.vis.quality, self._model.vis.global_
        quality.offsamples, frame.offwidth, frame.offheight = 0, image_size, image_size
        self._view = mujoco.MjvScene(self._model, maxgeom=scene.model.ngeom)
        self._view.flags[OFF] = False
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:], self._options.sitegroup[:] = 0, 0
        self._options.geomgroup[list(SHOWN_GROUPS)] = 1
        self._camera = mujoco.MjvCamera()
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self.camera
        self._rectangle = mujoco.MjrRect(0, 0, image_size, image_size)
        self._platform, self._context = open_context(self._model, image_size)
        weakref.finalize(self, _close, self._platform, self._context)

    def rgb(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W, 3) uint8 RGB of worlds ``ids`` (n,)."""
        self._platform.make_current()
        return np.stack([self._draw(int(i)) for i in ids])

    def segmentation(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) int32 geom ids of worlds ``ids`` (n,), -1 for a miss."""
        self._platform.make_current()
        self._view.flags[ID_COLORS] = True
        try:
            return np.stack([self._geom_ids(self._draw(int(i))) for i in ids])
        finally:
            self._view.flags[ID_COLORS] = False

    def depth(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) float32 depth along the optical axis [m] of worlds ``ids`` (n,), 0 for a miss."""
        self._platform.make_current()
        return np.stack([self._depth(int(i)) for i in ids])

    def _depth(self, i: int) -> np.ndarray:
        """(H, W) depth [m] of world ``i``, from OpenGL's, which is hyperbolic between the near and the far plane."""
        self._draw(i)
        buffer = np.empty((self.image_size, self.image_size), np.float32)
        mujoco.mjr_readPixels(None, buffer, self._rectangle, self._context)
        near, far = np.array([self._model.vis.map.znear, self._model.vis.map.zfar]) * self._model.stat.extent
        depth = near / (1.0 - buffer * (1.0 - near / far))
        return np.where(buffer == 1.0, 0.0, depth)[::-1].astype(np.float32)

    def _draw(self, i: int) -> np.ndarray:
        """(H, W, 3) uint8 image of world ``i``."""
        model, data = self.batch.get_model(i, self._model), self.batch.get_data(i, self._data)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(model, data, self._options, None, self._camera, everything, self._view)
        mujoco.mjr_render(self._rectangle, self._view, self._context)
        pixels = np.empty((self.image_size, self.image_size, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._rectangle, self._context)
        return pixels[::-1]  # OpenGL counts rows from below

    def _geom_ids(self, encoded: np.ndarray) -> np.ndarray:
        """(H, W) geom ids from an image whose colours encode segment ids from 1."""
        numbers = encoded.astype(np.int32) @ np.array([1, 2**8, 2**16], np.int32)
        ids = np.full(self._view.ngeom + 1, -1, np.int32)
        for geom in self._view.geoms[: self._view.ngeom]:
            if geom.objtype == GEOM:
                ids[geom.segid + 1] = geom.objid
        return ids[numbers]


def open_context(model: mujoco.MjModel, image_size: int) -> tuple[Any, mujoco.MjrContext]:
    """Return a current platform context and MuJoCo's resources in it.

    Raises:
        RuntimeError: if this machine offers no OpenGL.
    """
    try:
        opened = _platform_class()(image_size, image_size)
        opened.make_current()
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50.value)
    except (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError) as error:
        raise RuntimeError(
            f"the renderer 'opengl' finds no OpenGL on this machine ({error}); install it (Debian: apt install libegl1 "
            "libgl1-mesa-dri) or use the renderer 'tiles', which needs none"
        ) from error
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
    return opened, context


def _platform_class() -> Any:
    """MuJoCo's choice if the user has made one or has no Linux, else EGL, which needs no display."""
    if os.environ.get("MUJOCO_GL") or platform.system() != "Linux":
        return mujoco.GLContext
    from mujoco.egl import GLContext

    return GLContext


def _close(opened: Any, context: mujoco.MjrContext) -> None:
    opened.make_current()
    context.free()
    opened.free()
