"""A ray caster made for this scene: primitive shapes, one directional light, and tiles that list
their shapes.

Each frame, every shape is transformed into its own frame, in which rays are cheap to intersect, and
listed with the image tiles that its bounds overlap. A pixel then tests the shapes of its tile and
no others; for shadows it tests the shapes between the surfaces of its tile and the light.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ClassVar

import mujoco
import numpy as np
import warp as wp
from mujoco.batch import Batch

from dynahoi_lerobot.renderers.base import RENDERERS, Renderer
from dynahoi_lerobot.renderers.raycast.device import Mirror, default_device, world_fields
from dynahoi_lerobot.renderers.raycast.images import render_color, smooth_edges, trace
from dynahoi_lerobot.renderers.raycast.rows import Look
from dynahoi_lerobot.renderers.raycast.shapes import GEOM_TYPES
from dynahoi_lerobot.renderers.raycast.textures import textures_of
from dynahoi_lerobot.renderers.raycast.tiling import (
    TILE,
    CameraIntrinsics,
    place_shapes,
    sort_casters,
    sort_into_tiles,
    worlds_of,
)
from dynahoi_lerobot.scene.model import ARENA_HALF_M, SHOWN_GROUPS
from dynahoi_lerobot.scene.pinhole import Pinhole
from dynahoi_lerobot.scene.scene import Scene

GROUND_LIGHT, SKY_LIGHT = 0.24, 0.15
"""Light from the ground and the addition of the sky at a right angle, if the light is soft."""
SUN_WRAP, SKY_WRAP = 0.12, 1.0
"""How far beyond a right angle soft light reaches around a shape, as a cosine."""
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
"""Fields of the model and of the data that differ between worlds, with the element types of their
device copies."""


@RENDERERS.register("tiles")
class TileRenderer(Renderer):
    """Renders all worlds in one call, on the CPU without OpenGL or on CUDA, from the same source.

    A directional light with soft shadows, light from the sky and from the ground, darker corners,
    textures that are as sharp as a pixel allows, highlights, one translucent layer, and four
    samples for pixels on edges. Geom ids and depth are as in ``flat``. The image of a world
    depends neither on the other worlds of the batch nor on the number of threads.
    """

    soft: ClassVar[bool] = True

    def __init__(self, scene: Scene, batch: Batch, image_size: int, camera: str) -> None:
        """Compile the kernels (once per machine) and allocate device arrays, on CUDA if there is
        any.

        Raises:
            ValueError: if the scene holds shapes, textures or lights that this renderer does not
                know.
        """
        super().__init__(scene, batch, image_size, camera)
        self._shown = np.flatnonzero(np.isin(scene.model.geom_group, SHOWN_GROUPS)).astype(np.int32)
        _check_model(scene.model, self._shown)
        device = default_device()
        threads = batch.nthread if device == "cpu" else 1
        sources = world_fields(batch, APPEARANCE_FIELDS, POSE_FIELDS)
        types = APPEARANCE_FIELDS | POSE_FIELDS
        with wp.ScopedDevice(device):
            fields = {
                name: wp.empty(source.shape[:2], dtype=types[name])
                for name, source in sources.items()
            }
            self._mirror = Mirror(sources, fields)
            self._intrinsics = _intrinsics(scene.model, self.camera, image_size)
            self._worlds = worlds_of(fields, self._intrinsics, len(self._shown))
            self._record_launches(fields, threads)
        self._pool = ThreadPoolExecutor(threads)

    def rgb(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W, 3) uint8 RGB of worlds ``ids`` (n,)."""
        self._trace(ids)
        if self.soft:
            _launch(self._sorting_casters, len(ids), self._intrinsics.tiles_across**2)
        self._in_bands(self._coloring, len(ids))
        if self.soft:
            self._in_bands(self._smoothing, len(ids))
        return self._worlds.images[: len(ids)].numpy().copy()

    def segmentation(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) int32 geom ids of worlds ``ids`` (n,), -1 for a miss."""
        self._trace(ids)
        visible = self._pixels(self._worlds.visible, len(ids))
        return np.where(visible >= 0, self._shown[visible], -1)

    def depth(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) float32 depth along the optical axis [m] of worlds ``ids`` (n,), 0 for a
        miss.
        """
        self._trace(ids)
        visible = self._pixels(self._worlds.visible, len(ids))
        depths = self._pixels(self._worlds.depths, len(ids))
        return np.where(visible >= 0, depths, np.float32(0))

    def _record_launches(self, fields: Mapping[str, wp.array], threads: int) -> None:
        """Record all launches, as to repeat one is much cheaper than a new one; threads need one
        each.
        """
        model = self.scene.model
        intrinsics = self._intrinsics
        worlds = self._worlds
        casts = ~np.isin(self._shown, [self.scene.floor_geom, *self.scene.wall_geoms])
        look = _look(self.scene, self._shown, intrinsics, soft=self.soft)
        textures = textures_of(model, filtered=self.soft)
        geoms = [
            wp.array(self._shown, dtype=int),
            wp.array(casts.astype(np.int32), dtype=int),
            wp.array(model.geom_type[self._shown], dtype=int),
            wp.array(model.mat_texid[:, mujoco.mjtTextureRole.mjTEXROLE_RGB.value], dtype=int),
            wp.array(model.mat_texrepeat, dtype=wp.vec2),
            *(
                fields[name]
                for name in ("geom_size", "geom_rgba", "geom_matid", "geom_xpos", "geom_xmat")
            ),
        ]
        room = wp.array(np.flatnonzero(~casts).astype(np.int32), dtype=int)
        self._placing = _recorded(place_shapes, [intrinsics, *geoms, worlds])
        self._sorting = _recorded(sort_into_tiles, [intrinsics, room, worlds])
        self._sorting_casters = _recorded(sort_casters, [intrinsics, worlds])
        coloring = [0, intrinsics, look, textures, worlds]
        self._tracing = [_recorded(trace, [0, intrinsics, worlds]) for _ in range(threads)]
        self._coloring = [_recorded(render_color, coloring) for _ in range(threads)]
        self._smoothing = [_recorded(smooth_edges, [0, intrinsics, worlds]) for _ in range(threads)]

    def _trace(self, ids: np.ndarray) -> None:
        """Find the shapes that the pixels of worlds ``ids`` (n,) show, in the first n rows."""
        self._mirror.copy(ids)
        _launch(self._placing, len(ids), len(self._shown))
        _launch(self._sorting, len(ids), self._intrinsics.tiles_across**2)
        self._in_bands(self._tracing, len(ids))

    def _in_bands(self, launches: Sequence[Any], n_worlds: int) -> None:
        """Share the pixel rows of all images, numbered consecutively, among threads: each has a
        recorded launch.
        """
        edges = np.linspace(0, n_worlds * self.image_size, len(launches) + 1).astype(int).tolist()
        if len(launches) == 1:
            self._band(launches[0], *edges)
        else:
            list(self._pool.map(self._band, launches, edges[:-1], edges[1:]))

    def _band(self, launch: Any, first_row: int, end_row: int) -> None:
        launch.set_param_at_index(0, first_row)
        _launch(launch, end_row - first_row, self._intrinsics.tiles_across)

    def _pixels(self, rows: wp.array, n_worlds: int) -> np.ndarray:
        """(n, H, W) pixels of the first n worlds, without what the last tiles hold beyond the
        image.
        """
        pixels = rows[:n_worlds].numpy()  # (n, H, tiles across, 16)
        return pixels.reshape(n_worlds, self.image_size, -1)[..., : self.image_size]


@RENDERERS.register("flat")
class FlatRenderer(TileRenderer):
    """Draws as MuJoCo's other renderers do: one sample per pixel, no shadows, sharp textures, a
    headlight.

    It draws what ``warp`` does, an order of magnitude faster, and highlights and one translucent
    layer.

    The reference that ties ``tiles`` to MuJoCo's renderers, and the control for what shadows and
    soft light are worth.
    """

    soft: ClassVar[bool] = False


def _check_model(model: mujoco.MjModel, shown: np.ndarray) -> None:
    unknown = set(model.geom_type[shown].tolist()) - GEOM_TYPES
    if unknown:
        raise ValueError(
            f"the renderer 'tiles' cannot draw MuJoCo's geom types {sorted(unknown)}; use 'warp'"
        )
    if model.nlight != 1 or model.light_type[0] != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL.value:
        raise ValueError(
            f"the renderer 'tiles' needs one directional light, the scene has {model.nlight}; "
            f"use 'warp'"
        )


def _recorded(kernel: Any, inputs: list[Any]) -> Any:
    return wp.launch(kernel, (1, 1), inputs=inputs, record_cmd=True)


def _launch(recorded: Any, *dim: int) -> None:
    recorded.set_dim(dim)
    recorded.launch()


def _intrinsics(model: mujoco.MjModel, camera: int, image_size: int) -> Any:
    intrinsics = CameraIntrinsics()
    intrinsics.camera = camera
    intrinsics.size = image_size
    intrinsics.tiles_across = -(-image_size // TILE)
    focal, _, _, _ = Pinhole.of(model, model.camera(camera).name).intrinsics(image_size)
    intrinsics.focal = focal
    return intrinsics


def _look(scene: Scene, shown: np.ndarray, intrinsics: Any, *, soft: bool) -> Any:
    headlight = scene.model.vis.headlight
    look = Look()
    look.soft = int(soft)
    look.ambient = wp.vec3(GROUND_LIGHT) if soft else wp.vec3(*headlight.ambient)
    look.fill = wp.vec3(SKY_LIGHT) if soft else wp.vec3(*headlight.diffuse)
    look.sun_wrap, look.fill_wrap = (SUN_WRAP, SKY_WRAP) if soft else (0.0, 0.0)
    look.pixel_rad = 1.0 / intrinsics.focal
    look.floor = int(np.flatnonzero(shown == scene.floor_geom)[0])
    look.room_half_m = ARENA_HALF_M
    return look
