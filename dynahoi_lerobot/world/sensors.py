"""What is measured of N worlds beyond the simulator's state: images, and where the fingertips
are.
"""

from __future__ import annotations

import zlib

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.core.conventions import (
    DEFAULT_IMAGE_SIZE_PX,
    DETECTOR_IMAGE_SIZE_PX,
    EGO_VIEW,
    FINGERS,
    RENDER_NOISE_STREAM,
)
from dynahoi_lerobot.core.features import EYE
from dynahoi_lerobot.core.image_sensor import image_sensor
from dynahoi_lerobot.core.numerics import matrix_to_rotvec
from dynahoi_lerobot.core.protocols import PROTOCOLS
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.renderers import RENDERERS, Renderer
from dynahoi_lerobot.renderers.views import MOTION_VIEW, VIEWS
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.scene.pinhole import Pinhole
from dynahoi_lerobot.scene.scene import Scene
from dynahoi_lerobot.scene.signed_distance import signed_distance
from dynahoi_lerobot.scene.world_fields import WorldFields
from dynahoi_lerobot.world.detector import Detector
from dynahoi_lerobot.world.frame_history import FrameHistory

KINEMATICS = mujoco.mjtStage.mjSTAGE_POS.value
STAGE_FRAMES = 32
"""Frames of an episode that are rendered together once it has ended."""
MOTION_FRAMES = [0, 2, 4]
"""How many frames ago the channels of ``ego_motion`` were seen."""
LUMINANCE = np.array([299, 587, 114], np.uint32)
"""Thousandths of red, green and blue (ITU-R BT.601)."""


def with_render_noise(
    image: np.ndarray, levels: int, seed: int, frame: int, view: str
) -> np.ndarray:
    """Return an image (H, W, 3) uint8 whose values have changed by at most ``levels``, as from
    renderer to renderer.

    The changes are uniform whole numbers, a function of the episode's seed, the frame and the view.
    """
    rng = np.random.default_rng([RENDER_NOISE_STREAM, seed, frame, zlib.crc32(view.encode())])
    change = rng.integers(-levels, levels, image.shape, np.int16, endpoint=True)
    return np.clip(image + change, 0, 255).astype(np.uint8)


def _gray(image: np.ndarray) -> np.ndarray:
    """(H, W) uint8 luminance of an RGB image, in whole numbers, which round alike everywhere."""
    return ((image.astype(np.uint32) @ LUMINANCE + 500) // 1000).astype(np.uint8)


class Cameras:
    """What N worlds show of their episodes: the views of their rules, with render noise, and what
    the eye sees in them.

    A camera costs nothing until something is drawn through it.

    Attributes:
        image_size: side of the square images [px].
        in_order: whether an image depends on earlier ones, or a column on images, so that frames
            must be seen in turn.
    """

    def __init__(
        self,
        scene: Scene,
        batch: Batch,
        rules: Rules,
        specs: list[EpisodeSpec | None],
        frame: np.ndarray,
    ) -> None:
        """Show ``batch``, which runs ``scene.model`` by ``rules``.

        ``specs`` and ``frame`` (N,) of its episodes are kept up to date by whoever plays them.

        Raises:
            ValueError: for an eye without the ObAct plugin.
        """
        looks = rules.environment_state == EYE
        self.image_size = rules.image_size or (
            DETECTOR_IMAGE_SIZE_PX if looks else DEFAULT_IMAGE_SIZE_PX
        )
        self._scene = scene
        self._batch = batch
        self._rules = rules
        self._specs = specs
        self._frame = frame
        self._renderers: dict[str, Renderer] = {}
        self._views = (EGO_VIEW, *rules.views)
        self._gray = FrameHistory(
            batch.nsim, MOTION_FRAMES[-1] + 1, (self.image_size, self.image_size), np.uint8
        )
        self._detector = _detector(scene, batch, self.image_size) if looks else None
        self.in_order = looks or MOTION_VIEW in self._views

    def forget(self, ids: np.ndarray) -> None:
        """Forget the images of worlds ``ids`` (n,), whose episodes begin."""
        self._gray.forget(ids)
        if self._detector is not None:
            self._detector.forget(ids)

    def images(self, ids: np.ndarray) -> dict[str, np.ndarray]:
        """Return (N, H, W, 3) uint8 of each view; worlds not among ``ids`` (n,) or blinded by
        protocol are black.
        """
        seeing = self._seeing(ids)
        shown = {view: self._image(view, seeing) for view in self._views if view != MOTION_VIEW}
        if MOTION_VIEW in self._views:
            shown[MOTION_VIEW] = self._motion(shown[EGO_VIEW], seeing)
        return {view: shown[view] for view in self._views}

    def sighting(
        self, shown: dict[str, np.ndarray], palm: np.ndarray, ids: np.ndarray
    ) -> np.ndarray | None:
        """Return (N, 14) float32 where the eye sees the targets of worlds ``ids`` (n,), None
        without an eye.

        Args:
            shown: what ``images`` returned; empty if they are not shown.
            palm: (N, 3) palm center position [m].
            ids: worlds to look at.
        """
        if self._detector is None:
            return None
        images = shown[EGO_VIEW] if shown else self._image(EGO_VIEW, self._seeing(ids))
        return self._detector.see(images, palm, ids, self._frame)

    def render(self, ids: np.ndarray | None = None, view: str = EGO_VIEW) -> np.ndarray:
        """Return (N, H, W, 3) uint8 RGB of a view; only worlds ``ids`` (default: all) are drawn,
        others are black.
        """
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
        return self._renderer(EGO_VIEW).segmentation(np.arange(self._batch.nsim))

    def depth(self) -> np.ndarray:
        """Return (N, H, W) float32 depth along the axis of the hand's camera [m], 0 where nothing
        is.
        """
        return self._renderer(EGO_VIEW).depth(np.arange(self._batch.nsim))

    def _image(self, view: str, ids: np.ndarray) -> np.ndarray:
        """(N, H, W, 3) uint8 RGB of a view with its render noise; only worlds ``ids`` (n,) are
        drawn.
        """
        images = self.render(ids, view)
        levels = self._rules.render_noise
        if levels:
            images = images.copy()
            for i in ids:
                spec = self._specs[i]
                if spec is not None:
                    images[i] = with_render_noise(
                        images[i], levels, spec.seed, int(self._frame[i]), view
                    )
        return images

    def _motion(self, images: np.ndarray, ids: np.ndarray) -> np.ndarray:
        """(N, H, W, 3) uint8 gray now, two and four frames ago, of worlds ``ids`` (n,); others are
        black.
        """
        motion = np.zeros_like(images)
        for i in ids:
            self._gray.add(i, _gray(images[i]), int(self._frame[i]))
            motion[i] = np.moveaxis(self._gray.values[MOTION_FRAMES, i], 0, -1)
        return motion

    def _seeing(self, ids: np.ndarray) -> np.ndarray:
        """Return the worlds among ``ids`` (n,) whose protocol lets them see now."""
        blind = [
            spec is not None
            and PROTOCOLS[spec.protocol].blind_control
            and frame >= spec.window_frames
            for spec, frame in zip(self._specs, self._frame, strict=True)
        ]
        return np.setdiff1d(ids, np.flatnonzero(blind))

    def _renderer(self, camera: str) -> Renderer:
        if camera not in self._renderers:
            renderer = RENDERERS[self._rules.renderer]
            self._renderers[camera] = renderer(self._scene, self._batch, self.image_size, camera)
            self._batch.forward(stage=KINEMATICS)  # a new renderer asks the batch for further poses
        return self._renderers[camera]


def _detector(scene: Scene, batch: Batch, image_size: int) -> Detector:
    """Return the eye on the hand's camera; ValueError if nothing that is installed brings it."""
    camera = Pinhole.of(scene.model, EGO_VIEW)
    eye = image_sensor(EYE)(EGO_VIEW)
    return Detector(eye, batch.nsim, camera.pose, camera.intrinsics(image_size))


class Stage:
    """Renders episodes that have been played, some frames at a time, each in a row of its own."""

    def __init__(self, scene: Scene, rules: Rules, threads: int) -> None:
        """Allocate the rows; ``threads`` are for kinematics, 0 for all cores."""
        self._batch = Batch(scene.model, nsim=STAGE_FRAMES, nthread=threads)
        self._fields = WorldFields(self._batch, scene)
        self._specs: list[EpisodeSpec | None] = [None] * STAGE_FRAMES
        self._frame = np.zeros(STAGE_FRAMES, int)
        self._cameras = Cameras(scene, self._batch, rules, self._specs, self._frame)

    def images(
        self, world: WorldFields, i: int, spec: EpisodeSpec, visual_states: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return (T, H, W, 3) uint8 of each view of an episode's first T frames, of which
        (T, nq + ngeom) ``visual_states`` are known.

        `Cameras` would have shown the same images while row ``i`` of ``world`` played ``spec``.
        """
        self._specs[:] = [spec] * STAGE_FRAMES
        parts = []
        for first in range(0, len(visual_states), STAGE_FRAMES):
            rows = self._fields.copy(world, i, visual_states[first : first + STAGE_FRAMES])
            self._frame[:] = first + np.arange(STAGE_FRAMES)
            self._batch.forward(rows, stage=KINEMATICS)
            parts.append(
                {view: images[rows] for view, images in self._cameras.images(rows).items()}
            )
        return {view: np.concatenate([part[view] for part in parts]) for view in parts[0]}


class Fingertips:
    """The five fingertips of N worlds, from a batch whose kinematics are up to date.

    ``frames`` copies what everything else is computed from, so that an episode's frames can be
    computed together when it has ended.
    """

    def __init__(self, scene: Scene, batch: Batch, fields: WorldFields) -> None:
        self._scene = scene
        self._fields = fields
        self._geom_pos = batch.bind("geom_xpos")
        self._geom_mat = batch.bind("geom_xmat")
        self._site_pos = batch.bind("site_xpos")
        self._site_mat = batch.bind("site_xmat")

    def frames(self, ids: np.ndarray) -> np.ndarray:
        """Return (n, 5 + S, 12) position [m] and rotation matrix, world, of each fingertip and of
        each of the S ``target_geoms`` in worlds ``ids`` (n,).
        """
        tips = self._scene.tip_sites
        solids = self._scene.target_geoms
        frames = np.empty((len(ids), len(tips) + len(solids), 12))
        rows = ids[:, None]
        frames[:, : len(tips), :3] = self._site_pos[rows, tips]
        frames[:, : len(tips), 3:] = self._site_mat[rows, tips]
        frames[:, len(tips) :, :3] = self._geom_pos[rows, solids]
        frames[:, len(tips) :, 3:] = self._geom_mat[rows, solids]
        return frames

    def poses(self, frames: np.ndarray, origin_w: np.ndarray) -> np.ndarray:
        """Return (T, 30), position [m] and rotation vector [rad] of each fingertip.

        Args:
            frames: (T, 5 + S, 12) of ``frames``.
            origin_w: (3,) or (T, 3) from where positions are counted [m], world.
        """
        tips = frames[:, : len(FINGERS)]
        position = tips[..., :3] - np.atleast_2d(origin_w)[:, None]  # (T, 5, 3)
        rotation = tips[..., 3:].reshape(*position.shape, 3)  # (T, 5, 3, 3)
        poses = np.concatenate([position, matrix_to_rotvec(rotation)], axis=-1)  # (T, 5, 6)
        return poses.reshape(len(frames), 6 * len(FINGERS))

    def target_distance(self, i: int, frames: np.ndarray) -> np.ndarray:
        """Return (T, 5), signed distance of each fingertip to the target's surface [m], negative
        inside.

        Args:
            i: the world, whose target it is.
            frames: (T, 5 + S, 12) of ``frames``.
        """
        tips, solids = np.split(frames, [len(FINGERS)], axis=1)
        nearest = np.full((len(frames), len(FINGERS)), np.inf)
        alpha, sizes = (self._fields.fields[name][i] for name in ("geom_rgba", "geom_size"))
        for shape, slots in self._scene.slots.items():
            for geom in slots:
                if alpha[geom, 3]:  # the target uses it
                    solid = solids[:, np.searchsorted(self._scene.target_geoms, geom)]  # (T, 12)
                    offset = tips[..., :3] - solid[:, None, :3]  # (T, 5, 3)
                    rotation = solid[:, 3:].reshape(-1, 1, 3, 3)
                    # transposed rotation times offset
                    local = (rotation * offset[..., None]).sum(axis=-2)
                    size = np.broadcast_to(sizes[geom], local.shape)
                    np.minimum(nearest, signed_distance(shape, local, size), out=nearest)
        return nearest
