"""A ray caster made for this scene: primitive shapes, one directional light, and tiles that list their shapes.

Each frame, every shape is transformed into its own frame, in which rays are cheap to intersect, and listed with the
image tiles that its bounds overlap. A pixel then tests the shapes of its tile and no others.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
import warp as wp
from mujoco.batch import Batch

wp.config.log_level = wp.LOG_WARNING  # before warp is initialised

from dynahoi_lerobot.hands.base import EGO_CAMERA  # noqa: E402
from dynahoi_lerobot.renderers.base import RENDERERS, Renderer  # noqa: E402
from dynahoi_lerobot.renderers.mirror import Mirror, default_device, world_fields  # noqa: E402
from dynahoi_lerobot.renderers.raycast.render import SharedLights, render_color, render_ids_and_depth  # noqa: E402
from dynahoi_lerobot.renderers.raycast.shapes import GEOM_TYPES  # noqa: E402
from dynahoi_lerobot.renderers.raycast.tiling import TILE, CameraIntrinsics, Shape, place_shapes, sort_into_tiles  # noqa: E402
from dynahoi_lerobot.scene.model import SHOWN_GROUP  # noqa: E402
from dynahoi_lerobot.scene.scene import Scene  # noqa: E402

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
    """All worlds in one call, on the CPU without OpenGL or on CUDA, from the same file.

    It draws the image that ``warp`` draws, an order of magnitude faster: one sample per pixel, textures, a directional
    light and the headlight, no shadows; and, unlike there, specular highlights and one translucent layer. The image of
    a world depends neither on the other worlds of the batch nor on the number of threads.
    """

    def __init__(
        self, scene: Scene, batch: Batch, image_size: int, camera: str = EGO_CAMERA, device: str | None = None
    ) -> None:
        """Compile the kernels (once per machine) and allocate device arrays.

        Args:
            scene, batch, image_size, camera: as ``Renderer`` takes them.
            device: warp's name of the device, ``cpu`` or ``cuda``; CUDA if there is one by default.

        Raises:
            ValueError: if the scene holds shapes, textures or lights that this renderer does not know.
        """
        super().__init__(scene, batch, image_size, camera)
        shown = np.flatnonzero(scene.model.geom_group == SHOWN_GROUP).astype(np.int32)
        _check_model(scene.model, shown)
        self._device = device or default_device()
        self._tiles_across = -(-image_size // TILE)
        with wp.ScopedDevice(self._device):
            self._mirror = _mirror_of(batch)
            self._images = _empty((batch.nsim, image_size, image_size), wp.vec3ub)
            self._labels = _empty((batch.nsim, image_size, image_size), int)
            self._depths = _empty((batch.nsim, image_size, image_size), float)
            self._record_launches(scene.model, shown, batch.nthread if self._device == "cpu" else 1)
        self._pool = ThreadPoolExecutor(len(self._color_launches))

    def rgb(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W, 3) uint8 RGB of worlds ``ids`` (n,)."""
        self._prepare(ids)
        edges = np.linspace(0, len(ids) * self.image_size, len(self._color_launches) + 1).astype(int).tolist()
        if len(self._color_launches) == 1:
            self._color_rows(0, *edges)
        else:
            list(self._pool.map(self._color_rows, range(len(self._color_launches)), edges[:-1], edges[1:]))
        return self._images[: len(ids)].numpy().copy()

    def segmentation(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) int32 geom ids of worlds ``ids`` (n,), -1 for a miss."""
        self._render_ids_and_depth(ids)
        return self._labels[: len(ids)].numpy().copy()

    def depth(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) float32 depth along the optical axis [m] of worlds ``ids`` (n,), 0 for a miss."""
        self._render_ids_and_depth(ids)
        return self._depths[: len(ids)].numpy().copy()

    def _render_ids_and_depth(self, ids: np.ndarray) -> None:
        """Render geom ids and depth of worlds ``ids`` (n,) into the first rows of the device arrays."""
        self._prepare(ids)
        self._ids_and_depth_launch.set_dim((len(ids), self.image_size, self._tiles_across))
        self._ids_and_depth_launch.launch()

    def _record_launches(self, model: mujoco.MjModel, shown: np.ndarray, threads: int) -> None:
        """Record the kernel launches: repeating a recorded launch is much cheaper than a new one."""
        nsim, tiles = self.batch.nsim, self._tiles_across**2
        intrinsics, geoms = _intrinsics(model, self.camera, self.image_size), wp.array(shown, dtype=int)
        shapes, bounds = _empty((nsim, len(shown)), Shape), _empty((nsim, len(shown)), wp.vec4)
        lists, counts = _empty((nsim, tiles, len(shown)), int), _empty((nsim, tiles), int)
        fixed = [wp.array(model.geom_type[shown], dtype=int)]
        fixed += [wp.array(model.mat_texid[:, mujoco.mjtTextureRole.mjTEXROLE_RGB.value], dtype=int)]
        fixed += [wp.array(model.mat_texrepeat, dtype=wp.vec2)]
        moving = [self._mirror.arrays[name] for name in ("geom_size", "geom_rgba", "geom_matid", *POSE_FIELDS)]
        self._place_launch = _recorded(place_shapes, 2, [intrinsics, geoms, *fixed, *moving, shapes, bounds])
        self._sort_launch = _recorded(sort_into_tiles, 2, [self._tiles_across, bounds, lists, counts])
        lights = [self._mirror.arrays[name] for name in ("light_diffuse", "light_specular")]
        inputs = [
            0,
            intrinsics,
            _shared_lights(model),
            shapes,
            lists,
            counts,
            *lights,
            wp.array(_textures(model), dtype=float),
        ]
        inputs += [self._images]
        self._color_launches = [_recorded(render_color, 2, inputs) for _ in range(threads)]
        self._ids_and_depth_launch = _recorded(
            render_ids_and_depth, 3, [intrinsics, geoms, shapes, lists, counts, self._labels, self._depths]
        )
        self._shapes = len(shown)

    def _prepare(self, ids: np.ndarray) -> None:
        """Copy worlds ``ids`` (n,) to the device, place their shapes and bin them into tiles."""
        self._mirror.copy(ids)
        self._place_launch.set_dim((len(ids), self._shapes))
        self._place_launch.launch()
        self._sort_launch.set_dim((len(ids), self._tiles_across**2))
        self._sort_launch.launch()

    def _color_rows(self, number: int, first_row: int, end_row: int) -> None:
        """Render pixel rows ``first_row`` to ``end_row`` with one of the recorded launches.

        The rows of all images are numbered consecutively.
        """
        launch = self._color_launches[number]
        launch.set_param_at_index(0, first_row)
        launch.set_dim((end_row - first_row, self._tiles_across))
        launch.launch()


def _recorded(kernel: Any, axes: int, inputs: list[Any]) -> Any:
    return wp.launch(kernel, (1,) * axes, inputs=inputs, record_cmd=True)


def _empty(shape: tuple[int, ...], dtype: Any) -> wp.array:
    return wp.empty(shape, dtype=dtype)


def _check_model(model: mujoco.MjModel, shown: np.ndarray) -> None:
    if unknown := set(model.geom_type[shown].tolist()) - GEOM_TYPES:
        raise ValueError(f"the renderer 'tiles' cannot draw MuJoCo's geom types {sorted(unknown)}; use 'warp'")
    if model.nlight != 1 or model.light_type[0] != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL.value:
        raise ValueError(f"the renderer 'tiles' needs one directional light, the scene has {model.nlight}; use 'warp'")


def _mirror_of(batch: Batch) -> Mirror:
    """Copies of the batch's fields on the current device."""
    sources, types = world_fields(batch, APPEARANCE_FIELDS, POSE_FIELDS), APPEARANCE_FIELDS | POSE_FIELDS
    return Mirror(sources, {name: _empty(source.shape[:2], types[name]) for name, source in sources.items()})


def _intrinsics(model: mujoco.MjModel, camera: int, image_size: int) -> Any:
    intrinsics = CameraIntrinsics()
    intrinsics.camera, intrinsics.size = camera, image_size
    intrinsics.focal = 0.5 * image_size / np.tan(0.5 * np.radians(model.cam_fovy[camera]))
    return intrinsics


def _shared_lights(model: mujoco.MjModel) -> Any:
    lights = SharedLights()
    lights.ambient, lights.headlight = model.vis.headlight.ambient, model.vis.headlight.diffuse
    return lights


def _textures(model: mujoco.MjModel) -> np.ndarray:
    """(K, S, S) brightness, 0 to 1, of the scene's grey square textures."""
    size = int(model.tex_width[0])
    return model.tex_data.reshape(model.ntex, size, size, 3)[..., 0].astype(np.float32) / 255
