"""The ray caster's device arrays and its kernel launches, in their order."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
import warp as wp

from dynahoi_lerobot.core.numerics import tan
from dynahoi_lerobot.renderers.raycast.images import Look, render_color, render_ids_and_depth, smooth_edges, trace
from dynahoi_lerobot.renderers.raycast.rows import LightFrame, Worlds
from dynahoi_lerobot.renderers.raycast.shadows import place_casters, place_lights, sort_casters
from dynahoi_lerobot.renderers.raycast.textures import textures_of
from dynahoi_lerobot.renderers.raycast.tiling import (
    TILE,
    CameraIntrinsics,
    Indices,
    Row,
    Shape,
    place_shapes,
    sort_into_tiles,
)
from dynahoi_lerobot.scene.model import ARENA_HALF_M

GROUND_LIGHT, SKY_LIGHT = 0.24, 0.15
"""Light from below and what the sky adds to it, at a right angle, if the light is soft."""
SUN_WRAP, SKY_WRAP = 0.12, 1.0
"""How far beyond a right angle soft light reaches around a shape, as a cosine."""

SUN_RADIUS_RAD = 0.02
"""Angular radius of the light."""


class Pipeline:
    """Draws the packed worlds of a mirror; launches are recorded, as to repeat one is much cheaper than a new one.

    Attributes:
        labels: (N, H, W) geom ids; ``distances``: (N, H, W) depth [m]; what was drawn last.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        shown: np.ndarray,
        casting: np.ndarray,
        fields: dict[str, wp.array],
        *,
        camera: int,
        image_size: int,
        soft: bool,
        threads: int,
    ) -> None:
        """Allocate arrays on warp's current device and compile the kernels (once per machine).

        Args:
            model: the scene's.
            shown: (S,) ids of the geoms to draw; ``casting``: (S,) which of them cast shadows, all but
                floor and walls.
            fields: per-world fields, of N rows each.
            camera: id in the model.
            image_size: side of the square images [px].
            soft: whether there are shadows, soft light, filtered textures and smooth edges.
            threads: that share the pixels of a call.
        """
        self._size, self._across, self._shapes = image_size, -(-image_size // TILE), len(shown)
        nsim = fields["geom_xpos"].shape[0]
        self._room = wp.array(np.flatnonzero(~casting).astype(np.int32), dtype=int)
        self._geoms, self._soft = wp.array(shown, dtype=int), soft
        self._intrinsics, self._fields = _intrinsics(model, camera, image_size), fields
        self._worlds = _worlds(fields, nsim, self._across**2, self._shapes)
        self._packed = wp.empty((nsim, image_size, self._across * TILE * 3 // 4), dtype=wp.uint32)
        self.labels = wp.empty((nsim, image_size, image_size), dtype=int)
        self.distances = wp.empty((nsim, image_size, image_size), dtype=float)
        rows = (nsim, image_size, self._across)
        self._pixels = [wp.empty(rows, dtype=Indices), wp.empty(rows, dtype=Row)]
        self._placing = [*self._record_shapes(model), *(self._record_casters(casting) if soft else [])]
        self._sorting_casters = self._record_caster_sorting() if soft else None
        look, textures = _look(model, shown, self._intrinsics, soft=soft), textures_of(model, filtered=soft)
        first = [0, self._intrinsics]
        tracing = [*first, self._worlds, *self._pixels]
        colors = wp.empty(rows, dtype=Indices)
        coloring = [*first, look, textures, self._worlds, *self._pixels, colors, self._packed]
        smoothing = [*tracing, colors, self._packed]
        self._tracing = [_recorded(trace, 2, tracing) for _ in range(threads)]
        self._coloring = [_recorded(render_color, 2, coloring) for _ in range(threads)]
        self._smoothing = [_recorded(smooth_edges, 2, smoothing) for _ in range(threads)]
        labelling = [self._intrinsics, self._geoms, self._worlds, self.labels, self.distances]
        self._labelling = _recorded(render_ids_and_depth, 3, labelling)
        self._pool = ThreadPoolExecutor(threads)

    def draw_images(self, n_worlds: int) -> np.ndarray:
        """Return (n, H, W, 3) uint8 images of the first ``n_worlds`` rows."""
        self._place(n_worlds)
        self._in_bands(self._tracing, n_worlds)
        if self._soft:
            _launch(self._sorting_casters, n_worlds, self._across**2)
        self._in_bands(self._coloring, n_worlds)
        if self._soft:
            self._in_bands(self._smoothing, n_worlds)
        rows = self._packed[:n_worlds].numpy().view(np.uint8).reshape(n_worlds, self._size, -1, 3)
        return rows[:, :, : self._size].copy()

    def draw_labels_and_distances(self, n_worlds: int) -> None:
        """Draw the first ``n_worlds`` rows into ``labels`` and ``distances``."""
        self._place(n_worlds)
        _launch(self._labelling, n_worlds, self._size, self._across)

    def _place(self, n_worlds: int) -> None:
        """Place shapes, light and shadow casters, and bin the shapes into tiles."""
        for launch, columns in self._placing:
            _launch(launch, n_worlds, *columns)

    def _record_shapes(self, model: mujoco.MjModel) -> list[tuple[Any, tuple[int, ...]]]:
        """Launches that place shapes and bin them, with what they are launched over beside the worlds."""
        bounds = wp.empty(self._worlds.shapes.shape, dtype=wp.vec4)
        fixed = [wp.array(model.geom_type[self._geoms.numpy()], dtype=int)]
        fixed += [wp.array(model.mat_texid[:, mujoco.mjtTextureRole.mjTEXROLE_RGB.value], dtype=int)]
        fixed += [wp.array(model.mat_texrepeat, dtype=wp.vec2)]
        names = ("geom_size", "geom_rgba", "geom_matid", "geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "light_xdir")
        moving = [self._fields[name] for name in names]
        placing = [self._intrinsics, self._geoms, *fixed, *moving, self._worlds.shapes, bounds]
        sorting = [self._intrinsics, self._across, self._room, self._worlds.shapes, bounds]
        sorting += [self._worlds.lists, self._worlds.counts]
        return [
            (_recorded(place_shapes, 2, placing), (self._shapes,)),
            (_recorded(sort_into_tiles, 2, sorting), (self._across**2,)),
        ]

    def _record_casters(self, casting: np.ndarray) -> list[tuple[Any, tuple[int, ...]]]:
        """Launches that place light frames and the bounds of shadow casters."""
        fields, worlds = self._fields, self._worlds
        cameras = [SUN_RADIUS_RAD, self._intrinsics.camera, fields["cam_xpos"], fields["cam_xmat"]]
        lights = [*cameras, fields["light_xdir"], worlds.light_frames]
        casters = [self._geoms, wp.array(casting.astype(np.int32), dtype=int), self._worlds.shapes]
        casters += [fields[name] for name in ("geom_xpos", "geom_xmat", "light_xdir")]
        return [
            (_recorded(place_lights, 1, lights), ()),
            (_recorded(place_casters, 2, [*casters, worlds.caster_lows, worlds.caster_highs]), (self._shapes,)),
        ]

    def _record_caster_sorting(self) -> Any:
        """Launch that lists the casters of each tile."""
        worlds = self._worlds
        seen = [self._intrinsics, self._across, worlds.light_frames, self._pixels[1]]
        casters = [worlds.caster_lows, worlds.caster_highs, worlds.casters, worlds.caster_counts]
        return _recorded(sort_casters, 2, [*seen, *casters])

    def _in_bands(self, launches: Sequence[Any], n_worlds: int) -> None:
        """Share the pixel rows of all images, numbered consecutively, among threads: each has a recorded launch."""
        edges = np.linspace(0, n_worlds * self._size, len(launches) + 1).astype(int).tolist()
        if len(launches) == 1:
            self._band(launches[0], *edges)
        else:
            list(self._pool.map(self._band, launches, edges[:-1], edges[1:]))

    def _band(self, launch: Any, first_row: int, end_row: int) -> None:
        launch.set_param_at_index(0, first_row)
        _launch(launch, end_row - first_row, self._across)


def _recorded(kernel: Any, axes: int, inputs: list[Any]) -> Any:
    return wp.launch(kernel, (1,) * axes, inputs=inputs, record_cmd=True)


def _launch(recorded: Any, *dim: int) -> None:
    recorded.set_dim(dim)
    recorded.launch()


def _intrinsics(model: mujoco.MjModel, camera: int, image_size: int) -> Any:
    intrinsics = CameraIntrinsics()
    intrinsics.camera, intrinsics.size = camera, image_size
    intrinsics.focal = 0.5 * image_size / tan(0.5 * np.radians(model.cam_fovy[camera]))
    pixels = np.arange(-(-image_size // TILE) * TILE, dtype=np.float32)
    slopes = (pixels + np.float32(0.5) - np.float32(0.5 * image_size)) / np.float32(intrinsics.focal)
    intrinsics.slopes = wp.array(slopes.reshape(-1, TILE), dtype=Row)
    return intrinsics


def _worlds(fields: dict[str, wp.array], nsim: int, tiles: int, shapes: int) -> Any:
    worlds = Worlds()
    worlds.shapes = wp.empty((nsim, shapes), dtype=Shape)
    worlds.lists, worlds.counts = wp.empty((nsim, tiles, shapes), dtype=int), wp.empty((nsim, tiles), dtype=int)
    worlds.casters, worlds.caster_counts = wp.empty_like(worlds.lists), wp.zeros_like(worlds.counts)
    worlds.caster_lows = wp.empty((nsim, shapes), dtype=wp.vec3)
    worlds.caster_highs = wp.empty((nsim, shapes), dtype=wp.vec3)
    worlds.light_frames = wp.empty(nsim, dtype=LightFrame)
    worlds.diffuse, worlds.specular = fields["light_diffuse"], fields["light_specular"]
    return worlds


def _look(model: mujoco.MjModel, shown: np.ndarray, intrinsics: Any, *, soft: bool) -> Any:
    headlight, look = model.vis.headlight, Look()
    look.soft = int(soft)
    look.ambient = wp.vec3(GROUND_LIGHT) if soft else wp.vec3(*headlight.ambient)
    look.fill = wp.vec3(SKY_LIGHT) if soft else wp.vec3(*headlight.diffuse)
    look.sun_wrap, look.fill_wrap = (SUN_WRAP, SKY_WRAP) if soft else (0.0, 0.0)
    look.pixel_rad = 1.0 / intrinsics.focal
    look.floor, look.room_half_m = int(np.flatnonzero(shown == model.geom("floor").id)[0]), ARENA_HALF_M
    return look
