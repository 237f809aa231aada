"""Where the hand waits: a home that makes the drawn intercept the earliest reachable one, with the
target in view.

The target never comes to the home by itself, and lies in no preferred direction from it, so that
neither a hand that stands still nor one that always goes the same way catches it. The open hand is
clear of tables, ramps and walls.

Visibility and clearance are decided for one reference hand, whatever hand the recipe plays, so that
every hand starts at the same place in the same episodes. All hands carry the same camera at the
same place; only what of the view they hide differs. The hand does not collide with fixtures, so
nothing else would stop it from waiting inside a table, where its camera sees what no real one
could.
"""

import functools
from collections.abc import Sequence

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, INTERCEPT_SPEED_M_S
from dynahoi_lerobot.core.numerics import product, segment_distance, tan
from dynahoi_lerobot.hands.base import SKIN_GROUP
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.sampling.benchmark import HOLD_CLEARANCE_M
from dynahoi_lerobot.sampling.timing import MIN_APPROACH_FRAMES, Timing
from dynahoi_lerobot.scene.clearance import REFERENCE_HAND, keeps_clear, open_reference_hand
from dynahoi_lerobot.scene.model import ARENA_HALF_M
from dynahoi_lerobot.scene.scene import compile_scene

DIRECTIONS = 192
"""Homes that are tried for one motion."""
MIN_CLEARANCE_M = 0.075
"""Least distance of the target from the palm center until control starts."""
MIN_FRONT_M = 0.015
"""Least distance of the target in front of the palm center, along +x, until control starts."""
MIN_VISIBLE_SHARE = 0.9
"""Least share of the window's frames in which the camera sees the target's center."""
HOME_HEIGHT_M = (0.15, 2.2)
MAX_HOME_ASIDE_M = 1.7
VIEW_MARGIN = 0.92
"""Share of the half field of view, from its middle, in which a point counts as seen."""
MIN_DEPTH_M = 0.05
SILHOUETTE_SIZE = 96
"""Rays along each side of the view with which the hand's silhouette is measured."""
COLLIDING_GROUPS = np.array([group != SKIN_GROUP for group in range(mujoco.mjNGROUP)], np.uint8)
"""The silhouette is that of the hand that collides, so that homes do not depend on how the hand is
drawn."""


def find_homes(
    paths_w: Sequence[np.ndarray], timing: Timing, rng: np.random.Generator
) -> np.ndarray:
    """Return those homes for the palm center, of some that are tried, that fit the motion until the
    intercept.

    The home lies ``travel_m`` away from the intercept, so that a hand of fixed speed arrives there
    together with the target and could not have met it at an earlier frame. A policy that knows the
    speed can therefore infer the intercept from the motion it observes. Homes from which the hand
    leaves in a direction near a drawn one come first: where the camera must see the target, most
    homes have it in front, and a hand that always went forwards would gain.

    Args:
        paths_w: (F, 3) path of the untouched target at every frame [m], world, at least to the
            intercept, which is the same in all of them: of the episode and of its twins.
        timing: frames and travel of the episode.
        rng: source of the directions tried.

    Returns:
        (K, 3) positions [m], world, best first; none if none of those tried will do.
    """
    start = timing.window_frames
    intercept = timing.intercept_frame
    meeting = paths_w[0][intercept]
    homes = meeting - timing.travel_m * draw_directions(rng)
    homes = homes.astype(np.float32).astype(np.float64)  # as datasets store it
    homes = homes[_in_workspace(homes)]
    for path_w in paths_w:
        homes = homes[~_reachable_earlier(path_w[start:intercept], homes)]
        homes = homes[_clear_of(path_w[start : intercept + 1], homes)]
        homes = homes[_watches(path_w[: start + 1], homes)]
    return homes


def draw_directions(rng: np.random.Generator) -> np.ndarray:
    """Draw (K, 3) unit vectors from the homes that ``find_homes`` tries to the intercept, world,
    those nearest to one of them first.
    """
    directions = rng.normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions[np.argsort(-product(directions, directions[0]), kind="stable")]


def choose_home(
    paths_w: Sequence[np.ndarray], timing: Timing, fixtures: Sequence[Box], homes: np.ndarray
) -> np.ndarray | None:
    """Return the first of ``homes`` (K, 3), from ``find_homes``, that the target never reaches by
    itself and that is clear of ``fixtures``, or None.

    ``paths_w`` are as there, (F, 3) [m], world, but over the whole episode. ``fixtures`` are the
    boxes around the motion, which the waiting hand must not touch, nor the palm on its way.
    """
    clear = np.all([_clear_of(path_w[timing.window_frames :], homes) for path_w in paths_w], axis=0)
    meeting = paths_w[0][timing.intercept_frame]
    fitting = (home for home in homes[clear] if keeps_clear(home[None], meeting, fixtures).all())
    return next(fitting, None)


def in_arena(path_w: np.ndarray) -> bool:
    """Tell whether a path (F, 3) [m], world, is finite and stays between the walls and above the
    floor.
    """
    inside = (np.abs(path_w[:, :2]) < ARENA_HALF_M).all() and (path_w[:, 2] > 0.0).all()
    return bool(inside and np.isfinite(path_w).all())


def _in_workspace(homes: np.ndarray) -> np.ndarray:
    """(K,) whether the gantry reaches the homes with room to spare."""
    low, high = HOME_HEIGHT_M
    aside = (np.abs(homes[:, :2]) < MAX_HOME_ASIDE_M).all(axis=1)
    return (homes[:, 2] > low) & (homes[:, 2] < high) & aside


def _reachable_earlier(path_w: np.ndarray, homes: np.ndarray) -> np.ndarray:
    """(K,) whether the hand could have met the target before the intercept; ``path_w`` starts at
    control start.
    """
    frames = np.arange(len(path_w))
    distance = np.linalg.norm(path_w - homes[:, None], axis=-1)  # (K, n)
    in_reach = distance <= INTERCEPT_SPEED_M_S * CONTROL_DT * frames
    return in_reach[:, MIN_APPROACH_FRAMES:].any(axis=1)


def _watches(window_w: np.ndarray, homes: np.ndarray) -> np.ndarray:
    """(K,) whether the target is clear of the hand, in front of it and in view in the window, path
    (W + 1, 3).
    """
    relative = window_w - homes[:, None]  # (K, W + 1, 3) from the palm center, world axes
    fits = (np.linalg.norm(relative, axis=-1) > MIN_CLEARANCE_M).all(axis=1)
    fits &= (relative[..., 0] > MIN_FRONT_M).all(axis=1)
    fits[fits] = visible(relative[fits]).mean(axis=1) >= MIN_VISIBLE_SHARE
    return fits


def _clear_of(path_w: np.ndarray, homes: np.ndarray) -> np.ndarray:
    """(K,) whether a hand that stays at home is out of the target's way; path (F, 3), straight
    between frames.
    """
    return np.all(segment_distance(homes, path_w) > HOLD_CLEARANCE_M, axis=1)


def visible(points: np.ndarray) -> np.ndarray:
    """Tell which points (..., 3) from the palm center [m], world axes, the open reference hand's
    camera sees.
    """
    pos, rotation, half = _camera()
    local = product(points - pos, rotation)  # x right, y up, z backwards
    depth = np.maximum(-local[..., 2], MIN_DEPTH_M)
    plane = local[..., :2] / (half * depth[..., None])  # -1 to 1 across the view
    in_view = (-local[..., 2] > MIN_DEPTH_M) & (np.abs(plane) < VIEW_MARGIN).all(axis=-1)
    column, row = np.moveaxis(
        ((np.clip(plane, -1, 1) + 1) / 2 * (SILHOUETTE_SIZE - 1)).round().astype(int), -1, 0
    )
    return in_view & (np.linalg.norm(local, axis=-1) < _hand_distance()[row, column])


@functools.cache
def _camera() -> tuple[np.ndarray, np.ndarray, float]:
    """Position (3,) [m] and rotation (3, 3) of the camera in the palm's frame, and tangent of half
    its view.
    """
    scene = compile_scene(REFERENCE_HAND)
    model = scene.model
    camera = scene.camera
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.cam_quat[camera])
    return (
        model.cam_pos[camera],
        rotation.reshape(3, 3),
        float(tan(np.radians(model.cam_fovy[camera]) / 2)),
    )


@functools.cache
def _hand_distance() -> np.ndarray:
    """(K, K) distance of the open hand from the camera [m], infinite beside it; rows upwards,
    columns rightwards.
    """
    scene, data = open_reference_hand()
    _, rotation, half = _camera()
    across = np.linspace(-half, half, SILHOUETTE_SIZE)
    x, y = np.meshgrid(across, across)
    directions = np.stack([x, y, -np.ones_like(x)], axis=-1)  # (K, K, 3)
    rays = product(directions.reshape(-1, 3), rotation.T)  # (K * K, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    geom = np.zeros(len(rays), np.int32)
    distance = np.zeros(len(rays))
    mujoco.mj_multiRay(
        scene.model,
        data,
        data.cam_xpos[scene.camera],
        rays.ravel(),
        COLLIDING_GROUPS,
        True,
        -1,
        geom,
        distance,
        None,
        len(rays),
        mujoco.mjMAXVAL,
    )
    hit = np.isin(geom, scene.hand_geoms) & (distance >= 0)
    return np.where(hit, distance, np.inf).reshape(SILHOUETTE_SIZE, SILHOUETTE_SIZE)
