"""Where the hand waits: a home that makes the drawn intercept the earliest reachable one, with the target in view.

The target never comes to the home by itself, and lies in no preferred direction from it, so that neither a hand that
stands still nor one that always goes the same way catches it. The open hand is clear of tables, ramps and walls.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynahoi_lerobot.foundation.conventions import CONTROL_DT, HAND_SPEED_M_S
from dynahoi_lerobot.foundation.products import product
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.sampling.benchmark import HOLD_CLEARANCE_M
from dynahoi_lerobot.sampling.fixture_clearance import keeps_clear
from dynahoi_lerobot.sampling.timing import MIN_APPROACH_FRAMES, Timing
from dynahoi_lerobot.sampling.visibility import visible
from dynahoi_lerobot.scene.model import ARENA_HALF_M

DIRECTIONS = 192
"""Homes that are tried for one motion."""
MIN_CLEARANCE_M = 0.075
"""Least distance of the target from the palm centre until control starts."""
MIN_FRONT_M = 0.015
"""Least distance of the target in front of the palm centre, along +x, until control starts."""
MIN_VISIBLE_SHARE = 0.9
"""Least share of the window's frames in which the camera sees the target's centre."""
HOME_HEIGHT_M = (0.15, 2.2)
MAX_HOME_ASIDE_M = 1.7


def find_homes(path_w: np.ndarray, timing: Timing, fixtures: Sequence[Box], rng: np.random.Generator) -> np.ndarray:
    """Return those homes for the palm centre, of some that are tried, that fit the motion until the intercept.

    The home lies ``travel_m`` away from the intercept, so that a hand of fixed speed arrives there together with the
    target and could not have met it at an earlier frame. A policy that knows the speed can therefore infer the
    intercept from the motion it observes. Homes from which the hand leaves in a direction near a drawn one come first:
    where the camera must see the target, most homes have it in front, and a hand that always went forwards would gain.

    Args:
        path_w: (F, 3) path of the untouched target at every frame [m], world, at least to the intercept.
        timing: frames and travel of the episode.
        fixtures: the boxes around the motion, which the waiting hand must not touch, nor the palm on its way.
        rng: source of the directions tried.

    Returns:
        (K, 3) positions [m], world, best first; none if none of those tried will do.
    """
    start, intercept = timing.window_frames, timing.intercept_frame
    homes = path_w[intercept] - timing.travel_m * _draw_directions(rng)
    homes = homes.astype(np.float32).astype(np.float64)  # as datasets store it
    homes = homes[_in_workspace(homes)]
    homes = homes[~_reachable_earlier(path_w[start:intercept], homes)]
    homes = homes[_clear_of(path_w[start : intercept + 1], homes)]
    homes = homes[_watches(path_w[: start + 1], homes)]
    return homes[keeps_clear(homes, path_w[intercept], fixtures)]


def choose_home(path_w: np.ndarray, timing: Timing, homes: np.ndarray) -> np.ndarray | None:
    """Return the first of ``homes`` (K, 3) that the target never reaches by itself, or None.

    Args:
        path_w: (F, 3) path of the untouched target over the whole episode [m], world.
        timing: frames and travel of the episode.
        homes: from ``find_homes``.
    """
    clear = _clear_of(path_w[timing.window_frames :], homes)
    return homes[clear.argmax()] if clear.any() else None


def _draw_directions(rng: np.random.Generator) -> np.ndarray:
    """(K, 3) unit vectors from home to the intercept, world, those nearest to one of them first."""
    directions = rng.normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions[np.argsort(-product(directions, directions[0]), kind="stable")]


def in_arena(path_w: np.ndarray) -> bool:
    """Tell whether a path (F, 3) [m], world, is finite and stays between the walls and above the floor."""
    inside = (np.abs(path_w[:, :2]) < ARENA_HALF_M).all() and (path_w[:, 2] > 0.0).all()
    return bool(inside and np.isfinite(path_w).all())


def _in_workspace(homes: np.ndarray) -> np.ndarray:
    """(K,) whether the gantry reaches the homes with room to spare."""
    low, high = HOME_HEIGHT_M
    aside = (np.abs(homes[:, :2]) < MAX_HOME_ASIDE_M).all(axis=1)
    return (homes[:, 2] > low) & (homes[:, 2] < high) & aside


def _reachable_earlier(path_w: np.ndarray, homes: np.ndarray) -> np.ndarray:
    """(K,) whether the hand could have met the target before the intercept; ``path_w`` starts at control start."""
    frames = np.arange(len(path_w))
    distance = np.linalg.norm(path_w - homes[:, None], axis=-1)  # (K, n)
    in_reach = distance <= HAND_SPEED_M_S * CONTROL_DT * frames
    return in_reach[:, MIN_APPROACH_FRAMES:].any(axis=1)


def _watches(window_w: np.ndarray, homes: np.ndarray) -> np.ndarray:
    """(K,) whether the target is clear of the hand, in front of it and in view in the window, path (W + 1, 3)."""
    relative = window_w - homes[:, None]  # (K, W + 1, 3) from the palm centre, world axes
    fits = (np.linalg.norm(relative, axis=-1) > MIN_CLEARANCE_M).all(axis=1)
    fits &= (relative[..., 0] > MIN_FRONT_M).all(axis=1)
    fits[fits] = visible(relative[fits]).mean(axis=1) >= MIN_VISIBLE_SHARE
    return fits


def _clear_of(path_w: np.ndarray, homes: np.ndarray) -> np.ndarray:
    """(K,) whether a hand that stays at home is out of the target's way; path (F, 3), straight between frames."""
    steps = np.diff(path_w, axis=0)  # (F - 1, 3)
    from_start = homes[:, None] - path_w[:-1]  # (K, F - 1, 3)
    share = np.einsum("kfd,fd->kf", from_start, steps) / np.maximum((steps**2).sum(axis=1), 1e-12)
    nearest = from_start - np.clip(share, 0.0, 1.0)[..., None] * steps
    return (np.linalg.norm(nearest, axis=-1) > HOLD_CLEARANCE_M).all(axis=1)
