"""What is measured of N worlds beyond the simulator's state: images, and where the fingertips are."""

import zlib
from collections.abc import Callable

import mujoco
import numpy as np
from mujoco.batch import Batch

from dynahoi_lerobot.core.conventions import DEFAULT_IMAGE_SIZE_PX, EGO_VIEW, FINGERS, RENDER_NOISE_STREAM
from dynahoi_lerobot.core.numerics import matrix_to_rotvec, tan
from dynahoi_lerobot.renderers import RENDERERS, Renderer
from dynahoi_lerobot.renderers.views import VIEWS
from dynahoi_lerobot.scene.scene import Scene
from dynahoi_lerobot.scene.signed_distance import signed_distance
from dynahoi_lerobot.scene.world_fields import WorldFields

MOTION_FRAMES = [0, 2, 4]
"""How many frames ago the channels of ``ego_motion`` were seen."""
LUMINANCE = np.array([299, 587, 114], np.uint32)
"""Thousandths of red, green and blue (ITU-R BT.601)."""


def with_render_noise(image: np.ndarray, levels: int, seed: int, frame: int, view: str) -> np.ndarray:
    """Return an image (H, W, 3) uint8 whose values have changed by at most ``levels``, as from renderer to renderer.

    The changes are uniform whole numbers, a function of the episode's seed, the frame and the view.
    """
    rng = np.random.default_rng([RENDER_NOISE_STREAM, seed, frame, zlib.crc32(view.encode())])
    change = rng.integers(-levels, levels, image.shape, np.int16, endpoint=True)
    return np.clip(image + change, 0, 255).astype(np.uint8)


class FrameHistory:
    """What was last measured in N worlds; before an episode's start stands what was measured first.

    Attributes:
        values: (depth, N, ...), newest first.
        frame: (N,) int, of each world's newest, -1 where there is none yet.
    """

    def __init__(self, size: int, depth: int, shape: tuple[int, ...], dtype: type = float) -> None:
        self.values, self.frame = np.zeros((depth, size, *shape), dtype), np.full(size, -1)

    def forget(self, ids: np.ndarray) -> None:
        """Forget worlds ``ids`` (n,), whose episodes begin."""
        self.frame[ids] = -1

    def add(self, i: int, value: np.ndarray, frame: int) -> None:
        """Add what is measured in world ``i`` at a frame; frames since the last that were left out show the same."""
        passed = frame - int(self.frame[i])
        if self.frame[i] < 0:
            self.values[:, i] = value
        elif passed:
            self.values[passed:, i] = self.values[:-passed, i].copy()
        self.values[: max(passed, 1), i] = value
        self.frame[i] = frame


class ImageHistory(FrameHistory):
    """The last grey images of N worlds, for ``ego_motion``."""

    def __init__(self, size: int, image_size: int) -> None:
        """Remember square images of ``image_size`` [px] of ``size`` worlds."""
        super().__init__(size, MOTION_FRAMES[-1] + 1, (image_size, image_size), np.uint8)

    def shown(self, images: np.ndarray, ids: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Add what worlds ``ids`` see, and return (N, H, W, 3) uint8 now, two and four frames ago; others are black.

        Args:
            images: (N, H, W, 3) uint8 RGB.
            ids: (n,) worlds that see.
            frames: (N,) of their episodes.
        """
        motion = np.zeros_like(images)
        for i in ids:
            self.add(i, _grey(images[i]), int(frames[i]))
            motion[i] = np.moveaxis(self.values[MOTION_FRAMES, i], 0, -1)
        return motion


def _grey(image: np.ndarray) -> np.ndarray:
    """(H, W) uint8 luminance of an RGB image, in whole numbers, which round alike everywhere."""
    return ((image.astype(np.uint32) @ LUMINANCE + 500) // 1000).astype(np.uint8)


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
        RENDERERS.check(renderer)
        self._renderer_name = renderer
        self._renderers: dict[str, Renderer] = {}

    def render(self, ids: np.ndarray | None = None, view: str = EGO_VIEW) -> np.ndarray:
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
        return self._renderer(EGO_VIEW).segmentation(np.arange(self._batch.nsim))

    def depth(self) -> np.ndarray:
        """Return (N, H, W) float32 depth along the axis of the hand's camera [m], 0 where nothing is."""
        return self._renderer(EGO_VIEW).depth(np.arange(self._batch.nsim))

    def _renderer(self, camera: str) -> Renderer:
        if camera not in self._renderers:
            renderer = RENDERERS[self._renderer_name]
            self._renderers[camera] = renderer(self._scene, self._batch, self.image_size, camera)
            self._update_kinematics()
        return self._renderers[camera]


class Fingertips:
    """Reads the five fingertips of N worlds from a batch whose kinematics are up to date."""

    def __init__(self, scene: Scene, batch: Batch, fields: WorldFields) -> None:
        self._scene, self._fields = scene, fields
        self._geom_pos, self._geom_mat = batch.bind("geom_xpos"), batch.bind("geom_xmat")
        self._site_pos, self._site_mat = batch.bind("site_xpos"), batch.bind("site_xmat")
        self._distance: np.ndarray | None = None

    def forget(self) -> None:
        """Drop the measured distances, because something has moved."""
        self._distance = None

    def poses(self, origin_w: np.ndarray) -> np.ndarray:
        """Return (N, 30), position [m] and rotation vector [rad] of each fingertip.

        Args:
            origin_w: (N, 3) from where positions are counted [m], world.
        """
        position = self._site_pos[:, self._scene.tip_sites] - origin_w[:, None]  # (N, 5, 3)
        rotation = self._site_mat[:, self._scene.tip_sites].reshape(*position.shape, 3)  # (N, 5, 3, 3)
        return np.concatenate([position, matrix_to_rotvec(rotation)], axis=-1).reshape(len(position), -1)

    def target_distance(self) -> np.ndarray:
        """Return (N, 5), signed distance of each fingertip to the target's surface [m], negative inside.

        Experts, recordings and contacts ask for the same one, so it is kept until ``forget``.
        """
        if self._distance is None:
            self._distance = self._measure()
        return self._distance

    def _measure(self) -> np.ndarray:
        tips = self._site_pos[:, self._scene.tip_sites]  # (N, 5, 3)
        nearest = np.full((len(tips), len(FINGERS)), np.inf)
        alpha, sizes = self._fields.fields["geom_rgba"][..., 3], self._fields.fields["geom_size"]
        for shape, ids in self._scene.slots.items():
            geoms = np.asarray(ids)  # (S,)
            offset = tips[:, :, None] - self._geom_pos[:, None, geoms]  # (N, 5, S, 3)
            rotation = self._geom_mat[:, geoms].reshape(len(tips), 1, len(geoms), 3, 3)
            local = (rotation * offset[..., None]).sum(axis=-2)  # transposed rotation times offset
            distance = signed_distance(shape, local, np.broadcast_to(sizes[:, None, geoms], local.shape))
            hidden = (alpha[:, geoms] == 0.0)[:, None]
            nearest = np.minimum(nearest, np.where(hidden, np.inf, distance).min(axis=2))
        return nearest


def camera_pose(model: mujoco.MjModel, camera: str) -> np.ndarray:
    """Return (7,) position [m] and quaternion wxyz of a camera in the frame of the body it is fixed to.

    The hand's camera is fixed to the palm, which does not turn and has its origin at the palm centre; the side camera
    to a body that is put where the palm centre waits.
    """
    found = model.camera(camera)
    return np.concatenate([found.pos, found.quat])


def intrinsics(model: mujoco.MjModel, camera: str, image_size: int) -> np.ndarray:
    """Return (4,) focal lengths fx and fy and principal point cx and cy [px] in square images of that side [px].

    The centre of the first pixel is at (0.5, 0.5).
    """
    half = image_size / 2
    focal = half / tan(np.radians(float(model.camera(camera).fovy[0])) / 2)
    return np.array([focal, focal, half, half])
