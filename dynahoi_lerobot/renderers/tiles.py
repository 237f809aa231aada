"""A ray caster made for this scene: simple shapes, one light, and tiles that know which shapes they may show.

Each frame, every shape is described in a frame of its own, in which rays are cheap to intersect, and entered in the
lists of the tiles that its outline can touch. A pixel then tries the shapes of its tile and no others.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
import warp as wp
from mujoco.batch import Batch

wp.config.log_level = wp.LOG_WARNING  # before anything initialises it

from dynahoi_lerobot.hands.base import EGO_CAMERA  # noqa: E402
from dynahoi_lerobot.renderers.base import RENDERERS, Renderer  # noqa: E402
from dynahoi_lerobot.renderers.mirror import Mirror  # noqa: E402
from dynahoi_lerobot.renderers.raycast.layout import TILE, Lens, Shape, place, sort_into_tiles  # noqa: E402
from dynahoi_lerobot.renderers.raycast.paint import Lamps, paint, survey  # noqa: E402
from dynahoi_lerobot.renderers.raycast.shapes import KINDS  # noqa: E402
from dynahoi_lerobot.scene.scene import SHOWN_GROUP, Scene  # noqa: E402

LOOK_FIELDS = {
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
"""What the batch knows of each world, and the element types of its copies on the device."""


@RENDERERS.register("tiles")
class TileRenderer(Renderer):
    """All worlds in one call, on the CPU without OpenGL or on CUDA, from the same file.

    The picture is the one that ``warp`` draws, an order of magnitude sooner: one sample per pixel, textures, a
    directional light and the headlight, no shadows; and, unlike there, highlights and one layer of what is translucent.
    What a world looks like depends neither on its neighbours nor on the number of threads.
    """

    def __init__(
        self, scene: Scene, batch: Batch, image_size: int, camera: str = EGO_CAMERA, device: str | None = None
    ) -> None:
        """Compile (once per machine) and allocate; ``device`` is warp's, CUDA if there is one by default.

        Raises:
            ValueError: if the scene holds shapes, textures or lights that this renderer does not know.
        """
        super().__init__(scene, batch, image_size, camera)
        shown = np.flatnonzero(scene.model.geom_group == SHOWN_GROUP).astype(np.int32)
        _check(scene.model, shown)
        self._device = device or ("cuda" if wp.is_cuda_available() else "cpu")
        self._across = -(-image_size // TILE)
        with wp.ScopedDevice(self._device):
            self._mirror = _mirror(batch)
            self._pictures = _empty((batch.nsim, image_size, image_size), wp.vec3ub)
            self._labels = _empty((batch.nsim, image_size, image_size), int)
            self._depths = _empty((batch.nsim, image_size, image_size), float)
            self._record(scene.model, shown, batch.nthread if self._device == "cpu" else 1)
        self._pool = ThreadPoolExecutor(len(self._painters))

    def rgb(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W, 3) uint8 RGB of worlds ``ids`` (n,)."""
        self._prepare(ids)
        edges = np.linspace(0, len(ids) * self.image_size, len(self._painters) + 1).astype(int).tolist()
        if len(self._painters) == 1:
            self._paint(0, *edges)
        else:
            list(self._pool.map(self._paint, range(len(self._painters)), edges[:-1], edges[1:]))
        return self._pictures[: len(ids)].numpy().copy()

    def segmentation(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) int32 geom ids, -1 where nothing is, of worlds ``ids`` (n,)."""
        self._survey(ids)
        return self._labels[: len(ids)].numpy().copy()

    def depth(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, H, W) float32 depth along the camera's axis [m], 0 where nothing is, of worlds ``ids`` (n,)."""
        self._survey(ids)
        return self._depths[: len(ids)].numpy().copy()

    def _survey(self, ids: np.ndarray) -> None:
        """Find what every pixel sees and how far away it is."""
        self._prepare(ids)
        self._surveyor.set_dim((len(ids), self.image_size, self._across))
        self._surveyor.launch()

    def _record(self, model: mujoco.MjModel, shown: np.ndarray, threads: int) -> None:
        """Record the kernels' launches: repeating one is much cheaper than launching it anew."""
        nsim, tiles = self.batch.nsim, self._across**2
        lens, lamps, numbers = _lens(model, self.camera, self.image_size), _lamps(model), wp.array(shown, dtype=int)
        shapes, outlines = _empty((nsim, len(shown)), Shape), _empty((nsim, len(shown)), wp.vec4)
        lists, counts = _empty((nsim, tiles, len(shown)), int), _empty((nsim, tiles), int)
        fixed = [wp.array(model.geom_type[shown], dtype=int)]
        fixed += [wp.array(model.mat_texid[:, mujoco.mjtTextureRole.mjTEXROLE_RGB.value], dtype=int)]
        fixed += [wp.array(model.mat_texrepeat, dtype=wp.vec2)]
        moving = [self._mirror.arrays[name] for name in ("geom_size", "geom_rgba", "geom_matid", *POSE_FIELDS)]
        self._placer = _recorded(place, 2, [lens, numbers, *fixed, *moving, shapes, outlines])
        self._sorter = _recorded(sort_into_tiles, 2, [self._across, outlines, lists, counts])
        lights = [self._mirror.arrays[name] for name in ("light_diffuse", "light_specular")]
        inputs = [0, lens, lamps, shapes, lists, counts, *lights, wp.array(_textures(model), dtype=float)]
        inputs += [self._pictures]
        self._painters = [_recorded(paint, 2, inputs) for _ in range(threads)]
        self._surveyor = _recorded(survey, 3, [lens, numbers, shapes, lists, counts, self._labels, self._depths])
        self._shapes = len(shown)

    def _prepare(self, ids: np.ndarray) -> None:
        """Bring worlds, shapes and the tiles' lists up to date."""
        self._mirror.copy(ids)
        self._placer.set_dim((len(ids), self._shapes))
        self._placer.launch()
        self._sorter.set_dim((len(ids), self._across**2))
        self._sorter.launch()

    def _paint(self, painter: int, first_row: int, end_row: int) -> None:
        """Let one painter paint these rows of all pictures, counted through."""
        launch = self._painters[painter]
        launch.set_param_at_index(0, first_row)
        launch.set_dim((end_row - first_row, self._across))
        launch.launch()


def _recorded(kernel: Any, axes: int, inputs: list[Any]) -> Any:
    return wp.launch(kernel, (1,) * axes, inputs=inputs, record_cmd=True)


def _empty(shape: tuple[int, ...], dtype: Any) -> wp.array:
    return wp.empty(shape, dtype=dtype)


def _check(model: mujoco.MjModel, shown: np.ndarray) -> None:
    if unknown := set(model.geom_type[shown].tolist()) - KINDS:
        raise ValueError(f"the renderer 'tiles' cannot draw MuJoCo's geom types {sorted(unknown)}; use 'warp'")
    if model.nlight != 1 or model.light_type[0] != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL.value:
        raise ValueError(f"the renderer 'tiles' needs one directional light, the scene has {model.nlight}; use 'warp'")


def _mirror(batch: Batch) -> Mirror:
    """Copies of the batch's fields on the current device."""
    sources = {name: batch.expand(name) for name in LOOK_FIELDS} | {name: batch.bind(name) for name in POSE_FIELDS}
    types = LOOK_FIELDS | POSE_FIELDS
    return Mirror(sources, {name: _empty(source.shape[:2], types[name]) for name, source in sources.items()})


def _lens(model: mujoco.MjModel, camera: int, image_size: int) -> Any:
    lens = Lens()
    lens.camera, lens.size = camera, image_size
    lens.focal = 0.5 * image_size / np.tan(0.5 * np.radians(model.cam_fovy[camera]))
    return lens


def _lamps(model: mujoco.MjModel) -> Any:
    lamps = Lamps()
    lamps.ambient, lamps.headlight = model.vis.headlight.ambient, model.vis.headlight.diffuse
    return lamps


def _textures(model: mujoco.MjModel) -> np.ndarray:
    """(K, S, S) brightness, 0 to 1, of the scene's grey square textures."""
    size = int(model.tex_width[0])
    return model.tex_data.reshape(model.ntex, size, size, 3)[..., 0].astype(np.float32) / 255
