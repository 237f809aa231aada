"""Ray casting with mujoco_warp, which supports every geom, texture and light of MuJoCo, on the CPU
or on CUDA.
"""

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco.batch import Batch

from dynahoi_lerobot.renderers.base import RENDERERS, Renderer
from dynahoi_lerobot.renderers.raycast.device import Mirror, default_device, world_fields
from dynahoi_lerobot.scene.model import SHOWN_GROUPS
from dynahoi_lerobot.scene.scene import Scene

APPEARANCE_FIELDS = ("geom_size", "geom_rgba", "geom_matid", "light_diffuse")
"""Model fields that differ between worlds and that the ray caster reads."""
POSE_FIELDS = ("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "light_xpos", "light_xdir")
"""Data fields that the simulation computes and the ray caster reads."""


@RENDERERS.register("warp")
class WarpRenderer(Renderer):
    """Copies worlds into mujoco_warp's arrays and casts one ray per pixel, with textures and
    without shadows.

    Worlds are packed into the first rows, so rendering a few of many costs no more than that; the
    image of a world does not depend on its row.
    """

    def __init__(self, scene: Scene, batch: Batch, image_size: int, camera: str) -> None:
        """Compile the kernels (once per machine) and allocate device arrays, on CUDA if there is
        any.
        """
        super().__init__(scene, batch, image_size, camera)
        self._device = default_device()
        with wp.ScopedDevice(self._device):
            self._model = mjw.put_model(scene.model)
            self._data = mjw.make_data(scene.model, nworld=batch.nsim)
            for name in APPEARANCE_FIELDS:
                shared = getattr(self._model, name)
                setattr(
                    self._model,
                    name,
                    wp.empty(dtype=shared.dtype, shape=(batch.nsim, *shared.shape[1:])),
                )
            self._context = mjw.create_render_context(
                scene.model,
                nworld=batch.nsim,
                cam_res=(image_size, image_size),
                cam_active=[camera],
                enabled_geom_groups=list(SHOWN_GROUPS),
                use_textures=True,
                use_shadows=False,
                enable_emission=False,
                enable_specular=False,
                enable_per_light_ambient=False,
                deterministic=True,
                render_rgb=True,
                render_seg=True,
                render_depth=True,
            )
        sources = world_fields(batch, APPEARANCE_FIELDS, POSE_FIELDS)
        targets = {name: getattr(self._model, name) for name in APPEARANCE_FIELDS}
        self._mirror = Mirror(
            sources, targets | {name: getattr(self._data, name) for name in POSE_FIELDS}
        )

    def rgb(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W, 3) uint8 RGB of worlds ``ids`` (n,)."""
        packed = self._rendered(self._context.rgb_data, ids)  # (n, H, W) 0xAARRGGBB
        return np.ascontiguousarray(packed[..., None].view(np.uint8)[..., 2::-1])

    def segmentation(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) int32 geom ids of worlds ``ids`` (n,), -1 for a miss."""
        return self._rendered(self._context.seg_data, ids)[..., 0]

    def depth(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) float32 depth along the optical axis [m] of worlds ``ids`` (n,), 0 for a
        miss.
        """
        return self._rendered(self._context.depth_data, ids)

    def _rendered(self, output: wp.array, ids: np.ndarray) -> np.ndarray:
        """(n, H, W, ...) one output of rendering worlds ``ids`` (n,)."""
        self._mirror.copy(ids)
        self._data.nworld = len(ids)
        with wp.ScopedDevice(self._device):
            mjw.refit_bvh(self._model, self._data, self._context)
            mjw.render(self._model, self._data, self._context)
        pixels = output.numpy()[: len(ids)].copy()  # the next call overwrites the original
        return pixels.reshape(len(ids), self.image_size, self.image_size, *pixels.shape[2:])
