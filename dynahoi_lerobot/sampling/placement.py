"""Where the hand waits: a home from which the intercept is the earliest reachable one and the target is in view."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.foundation.conventions import CONTROL_DT, HAND_SPEED_M_S
from dynahoi_lerobot.sampling.timing import MIN_APPROACH_FRAMES, Timing
from dynahoi_lerobot.sampling.visibility import in_sight
from dynahoi_lerobot.scene.scene import ARENA_HALF_M

CANDIDATES = 192
MAX_YAW_RAD, MAX_PITCH_RAD = 1.3, 0.8
"""Directions from home to the intercept: in front of the palm, which faces +x."""
CLEARANCE_M = 0.075
"""The target keeps this far from the palm centre until control starts."""
FRONT_M = 0.015
"""The target stays this far in front of the palm centre's plane during the window."""
VISIBLE_SHARE = 0.9
"""Share of the window in which the camera sees the target's centre."""
MIN_HOME_HEIGHT_M, MAX_HOME_HEIGHT_M = 0.15, 2.2
MAX_HOME_ASIDE_M = 1.7


def find_home(path_w: np.ndarray, timing: Timing, rng: np.random.Generator) -> np.ndarray | None:
    """Return a home for the palm centre, or None if this motion offers none.

    The home lies ``travel_m`` away from the intercept, so that a hand of fixed speed arrives together with the target
    and at no earlier frame; so a watcher who knows that speed can infer the intercept from the motion.

    Args:
        path_w: (F, 3) path of the untouched target at every frame [m], world, at least to the intercept.
        timing: frames and travel of the episode.
        rng: source of the candidate directions.

    Returns:
        (3,) position [m], world, or None.
    """
    control, meeting = timing.window_frames, timing.window_frames + timing.approach_frames
    homes = path_w[meeting] - timing.travel_m * _directions(rng)  # (K, 3)
    seen = path_w[: control + 1] - homes[:, None]  # (K, W + 1, 3) relative to the palm centre
    fits = _reachable(homes)
    fits &= (np.linalg.norm(seen, axis=-1) > CLEARANCE_M).all(axis=1)
    fits &= (seen[..., 0] > FRONT_M).all(axis=1)
    fits &= in_sight(seen).mean(axis=1) >= VISIBLE_SHARE
    fits &= ~_reachable_earlier(path_w[control:meeting], homes)
    chosen = np.flatnonzero(fits)
    return homes[chosen[0]] if chosen.size else None


def _directions(rng: np.random.Generator) -> np.ndarray:
    """(K, 3) unit vectors from home to the intercept."""
    yaw = rng.uniform(-MAX_YAW_RAD, MAX_YAW_RAD, CANDIDATES)
    pitch = rng.uniform(-MAX_PITCH_RAD, MAX_PITCH_RAD, CANDIDATES)
    return np.column_stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])


def in_arena(path_w: np.ndarray) -> bool:
    """Tell whether a path (F, 3) [m] stays between walls and above the floor."""
    inside = (np.abs(path_w[:, :2]) < ARENA_HALF_M).all() and (path_w[:, 2] > 0.0).all()
    return bool(inside and np.isfinite(path_w).all())


def _reachable(homes: np.ndarray) -> np.ndarray:
    height = homes[:, 2]
    return (
        (height > MIN_HOME_HEIGHT_M)
        & (height < MAX_HOME_HEIGHT_M)
        & (np.abs(homes[:, :2]) < MAX_HOME_ASIDE_M).all(axis=1)
    )


def _reachable_earlier(path_w: np.ndarray, homes: np.ndarray) -> np.ndarray:
    """(K,) whether the hand could have met the target before the intercept; ``path_w`` starts at control start."""
    frames = np.arange(len(path_w))
    distance = np.linalg.norm(path_w - homes[:, None], axis=-1)  # (K, n)
    in_reach = distance <= HAND_SPEED_M_S * CONTROL_DT * frames
    return in_reach[:, MIN_APPROACH_FRAMES:].any(axis=1)
