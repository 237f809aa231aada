"""Images of random configurations, posed without physics, with where the target is: what an eye
learns from.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, EGO_VIEW, HAND_DOF, PALM_DOF
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.pretrain.recipe import PretrainRecipe
from dynahoi_lerobot.sampling.randomization import RANDOMIZATIONS
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.scene.pinhole import Pinhole
from dynahoi_lerobot.scene.scene import compile_scene
from dynahoi_lerobot.world.batch import WorldBatch

POSES = 8
"""Configurations of a world before it shows another episode: to begin one costs as much as several
images."""
HOME_SHARE = 0.25
"""Share of the images from home, while the hand watches; that is where most of what stands about is
in view."""
NEAR_SHARE, APPROACH_SHARE = 0.35, 0.45
"""Shares of the other images with the palm at the target, where an error of centimeters decides,
and on its way there; in the rest it is anywhere behind it."""
NEAR_M = 0.06
"""Standard deviation of the palm from the target when it is near, along each axis [m]."""
STRAY_M = 0.04
"""Standard deviation of the palm from the straight way to the target, along each axis [m]."""
LEAD_FRAMES = 24
"""The way leads to where the target is at most this many frames later."""
NEAREST_M, FARTHEST_M = (0.02, -0.3, -0.3), (0.8, 0.3, 0.3)
"""Range of the target's position relative to the palm in the other images [m], world axes."""
OPEN_SHARE = 0.5
FINGERS_MOVE_SHARE = 0.4
"""Share of the other images in which the fingers move: else whatever moves in the hand would pass
for a target."""
MOST_OPENED, MOST_CLOSED = 0.3, 0.7
"""How far fingers may move between the two images, of the way from open to closed."""
REPEATED_SHARE = 0.03
"""Share of all images that come twice, as the first of an episode does."""
STILL_SHARE, FAST_SHARE = 0.15, 0.2
"""Shares of the other hands that stand still, and of the moving ones that may be fast."""
PALM_SPEEDS_M_S = [control.palm_speed_m_s for control in CONTROL_CLASSES.values()]
SLOW_M_S, FAST_M_S = min(PALM_SPEEDS_M_S), max(PALM_SPEEDS_M_S)
"""Speed limits of the slowest and the fastest control class."""
WANDER_M = 0.1
"""Standard deviation of the point that a moving hand heads for from the target, along each axis
[m]."""
LOWEST_PALM_M = 0.05
SLOWER, FASTER = 0.6, 1.6
"""Least and greatest speed of a target between the two images, relative to its own."""


@dataclass(frozen=True, eq=False)
class Snapshots:
    """N images of as many worlds.

    Attributes:
        images: (N, H, W, 6) uint8 RGB of a camera, and RGB one frame before.
        place: (N, 3) float32 target center relative to the palm center, or, if the camera stands
            still, to where that is at home [m], world axes.
        from_palm: (N, 3) target center relative to the palm center [m], world axes.
    """

    images: np.ndarray
    place: np.ndarray
    from_palm: np.ndarray


def calibration(recipe: PretrainRecipe) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera's pose (7,), as ``ego_camera_pose_palm``, and intrinsics (4,) [px], as
    ``ego_intrinsics``.
    """
    rules = recipe.episodes.rules
    camera = Pinhole.of(compile_scene(rules.hand_name).model, recipe.camera)
    return camera.pose, camera.intrinsics(rules.image_size)


class ImageStream:
    """The images of an eye's recipe, a batch for each update, from any update on.

    Each call starts a stream seeded by the recipe's seed, the update and the worker. Episodes are
    sampled at the first one; each of several workers shows a part of them.
    """

    def __init__(self, recipe: PretrainRecipe, worker: int = 0, n_workers: int = 1) -> None:
        self._recipe = recipe
        self._worker = worker
        self._n_workers = n_workers

    def __call__(self, update: int) -> Iterator[Snapshots]:
        """Yield images forever, as a run that resumes from ``update`` sees them; hands take
        turns.
        """
        rng = np.random.default_rng([self._recipe.seed, update, self._worker])
        by_hand = [
            snapshots(batch, specs, rng, self._recipe.camera) for batch, specs in self._shown
        ]
        return chain.from_iterable(zip(*by_hand, strict=True))

    @cached_property
    def _shown(self) -> list[tuple[WorldBatch, list[EpisodeSpec]]]:
        """For each hand, worlds and the episodes that they show."""
        episodes = self._recipe.episodes
        recipes = [changed(episodes, {"hand": hand}) for hand in self._recipe.hands] or [episodes]
        chosen = range(self._worker, self._recipe.n_episodes, self._n_workers)
        size = self._recipe.batch_size
        return [
            (WorldBatch(one.rules, size, threads=1), shown_specs(self._recipe, one, chosen))
            for one in recipes
        ]


def shown_specs(
    recipe: PretrainRecipe, episodes: Recipe, chosen: Sequence[int]
) -> list[EpisodeSpec]:
    """Return the ``chosen`` ones of the episodes that are shown; the last of all are randomized."""
    n_plain = round(recipe.n_episodes * (1 - recipe.randomized_share))
    randomized = replace(episodes, appearance=tuple(RANDOMIZATIONS))
    plain = sample_specs(episodes, [i for i in chosen if i < n_plain])
    return plain + sample_specs(randomized, [i for i in chosen if i >= n_plain])


def snapshots(
    batch: WorldBatch,
    specs: Sequence[EpisodeSpec],
    rng: np.random.Generator,
    camera: str = EGO_VIEW,
) -> Iterator[Snapshots]:
    """Yield images of all worlds of a batch forever: poses along the targets' paths and the hand's
    ways to them.

    Args:
        batch: of a recipe with the hand, the renderer and the image size.
        specs: episodes whose objects, paths and surroundings are shown; each serves many images.
        rng: source of every draw.
        camera: whose images these are, ``ego`` or ``side``.
    """
    while True:
        chosen = [specs[i] for i in rng.choice(len(specs), batch.size)]
        batch.reset(np.arange(batch.size), chosen)
        for _ in range(POSES):
            poses = np.stack([_pose(spec, rng) for spec in chosen])  # (N, 2, 21)
            turns = _turns(batch.size, rng)
            images = []
            for hand, target in (
                (poses[:, at, :HAND_DOF], poses[:, at, HAND_DOF:]) for at in (NOW, BEFORE)
            ):
                batch.place(hand, np.concatenate([target, turns], axis=1))
                images.append(batch.cameras.render(view=camera))
            palm = poses[:, NOW, :PALM_DOF]
            target = poses[:, NOW, HAND_DOF:]
            place = target - palm if camera == EGO_VIEW else target
            yield Snapshots(
                np.concatenate(images, axis=-1), place.astype(np.float32), target - palm
            )


NOW = 0
BEFORE = 1


def _pose(spec: EpisodeSpec, rng: np.random.Generator) -> np.ndarray:
    """Draw (2, 21) hand (18) and target (3) [m, rad], home frame, at a frame of an episode and at
    the one before.
    """
    path = spec.target_path_w - spec.home_pos_w
    pose = _at_home(spec, path, rng) if rng.random() < HOME_SHARE else _on_its_way(spec, path, rng)
    return pose[[NOW, NOW]] if rng.random() < REPEATED_SHARE else pose


def _at_home(spec: EpisodeSpec, path: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw (2, 21) a hand that watches the target on its path (F, 3) [m], home frame."""
    hand = np.concatenate([np.zeros(PALM_DOF), spec.open_joints])
    frame = min(int(rng.integers(1, spec.window_frames + LEAD_FRAMES)), len(path) - 1)
    return np.stack([np.concatenate([hand, path[frame]]), np.concatenate([hand, path[frame - 1]])])


def _on_its_way(spec: EpisodeSpec, path: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw (2, 21) a hand that moves to a target on its path (F, 3) [m], home frame."""
    frame = int(rng.integers(1, len(path)))
    before = path[frame] - rng.uniform(SLOWER, FASTER) * (path[frame] - path[frame - 1])
    palm = _palm(spec, path, frame, rng)
    step = np.zeros(PALM_DOF)
    if rng.random() > STILL_SHARE:
        direction = path[frame] - palm + rng.normal(0.0, WANDER_M, PALM_DOF)
        speed = rng.uniform(0.0, FAST_M_S if rng.random() < FAST_SHARE else SLOW_M_S)
        step = speed * CONTROL_DT * direction / max(float(np.linalg.norm(direction)), 1e-6)
    joints, joints_before = _fingers(spec, rng)
    return np.stack(
        [
            np.concatenate([palm, joints, path[frame]]),
            np.concatenate([palm - step, joints_before, before]),
        ]
    )


def _palm(spec: EpisodeSpec, path: np.ndarray, frame: int, rng: np.random.Generator) -> np.ndarray:
    """Draw (3,) a palm that may see the target at a frame of its path (F, 3) [m], home frame."""
    kind = rng.random()
    if kind < NEAR_SHARE:
        palm = path[frame] + rng.normal(0.0, NEAR_M, PALM_DOF)
    elif kind < NEAR_SHARE + APPROACH_SHARE:
        goal = path[min(frame + rng.integers(LEAD_FRAMES), len(path) - 1)]
        palm = rng.random() * goal + rng.normal(0.0, STRAY_M, PALM_DOF)
    else:
        palm = path[frame] - rng.uniform(NEAREST_M, FARTHEST_M)
    palm[2] = max(palm[2], LOWEST_PALM_M - spec.home_pos_w[2])
    return palm


def _fingers(spec: EpisodeSpec, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw (J,) joint angles [rad] now and one frame before."""
    moving = rng.random() < FINGERS_MOVE_SHARE
    closed = rng.random() if moving or rng.random() > OPEN_SHARE else 0.0
    before = (
        np.clip(closed + rng.uniform(-MOST_CLOSED, MOST_OPENED), 0.0, 1.0) if moving else closed
    )
    way = spec.reference_joints - spec.open_joints
    return spec.open_joints + closed * way, spec.open_joints + before * way


def _turns(count: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 4) random orientations, quaternions wxyz."""
    quat = rng.normal(size=(count, 4))
    return quat / np.linalg.norm(quat, axis=1, keepdims=True)
