"""Ray casting with mujoco_warp: all worlds in one call, on the CPU without OpenGL or on CUDA, from the same file."""

from __future__ import annotations

import functools

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco.batch import Batch

from dynahoi_lerobot.renderers.base import RENDERERS, Renderer
from dynahoi_lerobot.scene import Scene

WORLD_FIELDS = ("geom_size", "geom_rgba", "geom_matid", "light_diffuse")
"""Model fields whose values differ between worlds and which the ray caster reads."""
POSE_FIELDS = ("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "light_xpos", "light_xdir")
"""Data fields copied from the simulation before every image."""


@RENDERERS.register("warp")
class WarpRenderer(Renderer):
    """Copies poses into mujoco_warp's arrays and casts one ray per pixel, with textures and without shadows."""

    def __init__(self, scene: Scene, batch: Batch, image_size: int, device: str | None = None) -> None:
        """Compile (once per machine) and allocate; ``device`` is warp's, CUDA if there is one by default."""
        super().__init__(scene, batch, image_size)
        wp.config.quiet = True
        self._device = device or ("cuda" if wp.is_cuda_available() else "cpu")
        with wp.ScopedDevice(self._device):
            self._model, self._data = mjw.put_model(scene.model), mjw.make_data(scene.model, nworld=batch.nsim)
            for name in WORLD_FIELDS:
                shared = getattr(self._model, name)
                own = wp.empty(dtype=shared.dtype, shape=(batch.nsim, *shared.shape[1:]))
                setattr(self._model, name, own)
        self._poses = {name: batch.bind(name) for name in POSE_FIELDS}
        self._hosts = {name: wp.empty_like(getattr(self._data, name), device="cpu") for name in POSE_FIELDS}

    @functools.cached_property
    def _color(self) -> mjw.RenderContext:
        return self._context(render_rgb=True, render_seg=False)

    @functools.cached_property
    def _labels(self) -> mjw.RenderContext:
        return self._context(render_rgb=False, render_seg=True)

    def refresh(self, ids: np.ndarray) -> None:
        """Copy the appearance of worlds ``ids``."""
        del ids  # whole arrays are small, and one copy each is cheaper than many slices
        for name in WORLD_FIELDS:
            values = self.batch.expand(name)
            getattr(self._model, name).assign(np.ascontiguousarray(values, dtype=_host_dtype(values)))

    def rgb(self) -> np.ndarray:
        """Return (N, H, W, 3) uint8 RGB."""
        self._render(self._color)
        packed = self._color.rgb_data.numpy()  # (N, H * W) 0xAARRGGBB
        pixels = packed.view(np.uint8).reshape(self.batch.nsim, self.image_size, self.image_size, 4)
        return np.ascontiguousarray(pixels[..., 2::-1])

    def segmentation(self) -> np.ndarray:
        """Return (N, H, W) int32 geom ids, -1 where nothing is."""
        self._render(self._labels)
        labels = self._labels.seg_data.numpy()[..., 0]
        return labels.reshape(self.batch.nsim, self.image_size, self.image_size)

    def _context(self, **outputs: bool) -> mjw.RenderContext:
        with wp.ScopedDevice(self._device):
            return mjw.create_render_context(
                self.scene.model,
                nworld=self.batch.nsim,
                cam_res=(self.image_size, self.image_size),
                cam_active=[self.scene.model.camera(self.scene.camera).name],
                use_textures=True,
                use_shadows=False,
                enable_emission=False,
                enable_per_light_ambient=False,
                deterministic=True,
                **outputs,
            )

    def _render(self, context: mjw.RenderContext) -> None:
        for name, source in self._poses.items():
            target = self._hosts[name]
            target.numpy()[...] = source.reshape(target.numpy().shape)
            wp.copy(getattr(self._data, name), target)
        with wp.ScopedDevice(self._device):
            mjw.refit_bvh(self._model, self._data, context)
            mjw.render(self._model, self._data, context)


def _host_dtype(values: np.ndarray) -> type:
    return np.int32 if values.dtype.kind in "iu" else np.float32


def geom_names(model: mujoco.MjModel) -> list[str]:
    """Return the names behind the ids of ``segmentation``."""
    return [model.geom(i).name for i in range(model.ngeom)]
