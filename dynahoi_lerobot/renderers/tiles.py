"""A ray caster made for this scene: primitive shapes, one directional light, and tiles that list their shapes.

Each frame, every shape is transformed into its own frame, in which rays are cheap to intersect, and listed with the
image tiles that its bounds overlap. A pixel then tests the shapes of its tile and no others; and for shadows those
that lie between something its tile shows and the light.
"""

from typing import ClassVar

import mujoco
import numpy as np
import warp as wp
from mujoco.batch import Batch

from dynahoi_lerobot.renderers.base import RENDERERS, Renderer
from dynahoi_lerobot.renderers.device import Mirror, default_device, world_fields
from dynahoi_lerobot.renderers.raycast.pipeline import Pipeline
from dynahoi_lerobot.renderers.raycast.shapes import GEOM_TYPES
from dynahoi_lerobot.scene.model import SHOWN_GROUPS
from dynahoi_lerobot.scene.scene import Scene

APPEARANCE_FIELDS = {
    "geom_size": wp.vec3,
    "geom_rgba": wp.vec4,
    "geom_matid": int,
    "light_diffuse": wp.vec3,
    "light_specular": wp.vec3,
}
POSE_FIELDS = {
    "geom_xpos": wp.vec3,
    "geom_xmat": wp.mat33,
    "cam_xpos": wp.vec3,
    "cam_xmat": wp.mat33,
    "light_xdir": wp.vec3,
}
"""Fields of the model and of the data that differ between worlds, with the element types of their device copies."""


@RENDERERS.register("tiles")
class TileRenderer(Renderer):
    """Renders all worlds in one call, on the CPU without OpenGL or on CUDA, from the same source.

    A directional light with soft shadows, light from the sky and from the ground, darker corners, textures that are as
    sharp as a pixel allows, highlights, one translucent layer, and four samples for pixels on edges. Geom ids and depth
    are those of ``flat``. The image of a world depends neither on the other worlds of the batch nor on the number of
    threads.
    """

    soft: ClassVar[bool] = True

    def __init__(self, scene: Scene, batch: Batch, image_size: int, camera: str) -> None:
        """Compile the kernels (once per machine) and allocate device arrays, on CUDA if there is any.

        Raises:
            ValueError: if the scene holds shapes, textures or lights that this renderer does not know.
        """
        super().__init__(scene, batch, image_size, camera)
        shown = np.flatnonzero(np.isin(scene.model.geom_group, SHOWN_GROUPS)).astype(np.int32)
        _check_model(scene.model, shown)
        device = default_device()
        casting = ~np.isin(shown, [scene.floor_geom, *scene.wall_geoms])
        sources, types = world_fields(batch, APPEARANCE_FIELDS, POSE_FIELDS), APPEARANCE_FIELDS | POSE_FIELDS
        with wp.ScopedDevice(device):
            arrays = {name: wp.empty(source.shape[:2], dtype=types[name]) for name, source in sources.items()}
            self._mirror = Mirror(sources, arrays)
            self._pipeline = Pipeline(
                scene.model,
                shown,
                casting,
                self._mirror.arrays,
                camera=self.camera,
                image_size=image_size,
                soft=self.soft,
                threads=batch.nthread if device == "cpu" else 1,
            )

    def rgb(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W, 3) uint8 RGB of worlds ``ids`` (n,)."""
        self._mirror.copy(ids)
        return self._pipeline.draw_images(len(ids))

    def segmentation(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) int32 geom ids of worlds ``ids`` (n,), -1 for a miss."""
        self._mirror.copy(ids)
        self._pipeline.draw_labels_and_distances(len(ids))
        return self._pipeline.labels[: len(ids)].numpy().copy()

    def depth(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) float32 depth along the optical axis [m] of worlds ``ids`` (n,), 0 for a miss."""
        self._mirror.copy(ids)
        self._pipeline.draw_labels_and_distances(len(ids))
        return self._pipeline.distances[: len(ids)].numpy().copy()


@RENDERERS.register("flat")
class FlatRenderer(TileRenderer):
    """Draws as MuJoCo's other renderers do: one sample per pixel, no shadows, sharp textures, a headlight.

    It draws what ``warp`` does, an order of magnitude faster, and highlights and one translucent layer.

    The reference that ties ``tiles`` to MuJoCo's renderers, and the control for what shadows and soft light are worth.
    """

    soft: ClassVar[bool] = False


def _check_model(model: mujoco.MjModel, shown: np.ndarray) -> None:
    if unknown := set(model.geom_type[shown].tolist()) - GEOM_TYPES:
        raise ValueError(f"the renderer 'tiles' cannot draw MuJoCo's geom types {sorted(unknown)}; use 'warp'")
    if model.nlight != 1 or model.light_type[0] != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL.value:
        raise ValueError(f"the renderer 'tiles' needs one directional light, the scene has {model.nlight}; use 'warp'")
