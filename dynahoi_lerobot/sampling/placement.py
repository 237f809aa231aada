"""Where the hand waits: a home that makes the drawn intercept the earliest reachable one, with the target in view."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.foundation.conventions import CONTROL_DT, HAND_SPEED_M_S
from dynahoi_lerobot.sampling.timing import MIN_APPROACH_FRAMES, Timing
from dynahoi_lerobot.sampling.visibility import visible
from dynahoi_lerobot.scene.model import ARENA_HALF_M

DIRECTIONS = 192
"""Homes that are tried for one motion."""
MAX_YAW_RAD, MAX_PITCH_RAD = 1.3, 0.8
"""Directions from home to the intercept lie within these angles of +x, where the palm faces."""
MIN_CLEARANCE_M = 0.075
"""Least distance of the target from the palm centre until control starts."""
MIN_FRONT_M = 0.015
"""Least distance of the target in front of the palm centre, along +x, until control starts."""
MIN_VISIBLE_SHARE = 0.9
"""Least share of the window's frames in which the camera sees the target's centre."""
HOME_HEIGHT_M = (0.15, 2.2)
MAX_HOME_ASIDE_M = 1.7


def find_home(path_w: np.ndarray, timing: Timing, rng: np.random.Generator) -> np.ndarray | None:
    """Return a home for the palm centre, or None if none of those tried will do.

    The home lies ``travel_m`` away from the intercept, so that a hand of fixed speed arrives there together with the
    target and could not have met it at an earlier frame. A policy that knows the speed can therefore infer the
    intercept from the motion it observes.

    Args:
        path_w: (F, 3) path of the untouched target at every frame [m], world, at least to the intercept.
        timing: frames and travel of the episode.
        rng: source of the directions tried.

    Returns:
        (3,) position [m], world, or None.
    """
    start, intercept = timing.window_frames, timing.intercept_frame
    homes = path_w[intercept] - timing.travel_m * _draw_directions(rng)  # (K, 3)
    relative = path_w[: start + 1] - homes[:, None]  # (K, W + 1, 3) from the palm centre, world axes
    fits = _in_workspace(homes)
    fits &= (np.linalg.norm(relative, axis=-1) > MIN_CLEARANCE_M).all(axis=1)
    fits &= (relative[..., 0] > MIN_FRONT_M).all(axis=1)
    fits &= visible(relative).mean(axis=1) >= MIN_VISIBLE_SHARE
    fits &= ~_reachable_earlier(path_w[start:intercept], homes)
    return homes[fits.argmax()] if fits.any() else None


def _draw_directions(rng: np.random.Generator) -> np.ndarray:
    """(K, 3) unit vectors from home to the intercept, world."""
    yaw = rng.uniform(-MAX_YAW_RAD, MAX_YAW_RAD, DIRECTIONS)
    pitch = rng.uniform(-MAX_PITCH_RAD, MAX_PITCH_RAD, DIRECTIONS)
    return np.column_stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])


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
