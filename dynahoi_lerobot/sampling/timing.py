"""How long episodes last and how far the hand travels: the paper's two histograms, met by all kinds together.

Short-lived kinds (a throw lasts under a second) cannot fill the long bins, so the others must. The joint table of
kind, duration bin and travel bin is the one closest to independence that meets all three margins (iterative
proportional fitting).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.foundation.conventions import (
    CONTROL_DT,
    HAND_SPEED_M_S,
    LOCALIZATION_RADIUS_M,
    MIN_WINDOW_FRAMES,
    UNIT_M,
    WINDOW_FRACTION,
)
from dynahoi_lerobot.motions import MOTIONS, benchmark_motions

DURATION_EDGES = (20, 40, 60, 80, 120, 160)
"""Bins of L [frames] (Figure 3c); the last is open in the paper and ends at 160 here."""
DURATION_SHARES = (0.202, 0.361, 0.195, 0.139, 0.101)
TRAVEL_EDGES_M = (LOCALIZATION_RADIUS_M, 0.5 * UNIT_M, 2.0 * UNIT_M, 4.0 * UNIT_M, 6.0 * UNIT_M)
"""Bins of the hand's travel (Figure 3d); below 3 cm standing still would do, above 6 u nobody goes here."""
TRAVEL_SHARES = (0.2260, 0.5080, 0.1830, 0.0830)
"""The paper's 20.1, 47.7, 16.4 and 5.8 % leave 10 % unassigned; the bins share it so that none strays 3 points: the
third gets least, as episodes that are redrawn because the hand finds no home add a point to it."""

MIN_APPROACH_FRAMES = 5
"""No intercept before this: fingers need 0.25 s to close."""
MIN_HOLD_FRAMES = 6


@dataclass(frozen=True)
class Timing:
    """Frames and travel of one episode.

    Attributes:
        length_frames: L.
        window_frames: observation window, 0 for ``direct_act``.
        approach_frames: from control start to the intercept.
        travel_m: from home to the intercept.
    """

    length_frames: int
    window_frames: int
    approach_frames: int
    travel_m: float


def window_frames(length_frames: int) -> int:
    """Return the first 20 % of the frames, at least 8."""
    return max(MIN_WINDOW_FRAMES, int(np.ceil(WINDOW_FRACTION * length_frames)))


def approach_frames(travel_m: float) -> int:
    """Return how many frames the hand needs for ``travel_m`` at its fixed speed, at least 5."""
    return max(MIN_APPROACH_FRAMES, int(np.ceil(travel_m / (HAND_SPEED_M_S * CONTROL_DT) - 1e-9)))


def draw_timing(kind: str, protocol: str, rng: np.random.Generator) -> Timing:
    """Draw duration and travel for one episode of ``kind``."""
    table = kind_table(kind)
    duration, travel = np.unravel_index(rng.choice(table.size, p=table.ravel()), table.shape)
    farthest = MOTIONS[kind].max_approach_frames * HAND_SPEED_M_S * CONTROL_DT
    travel_m = rng.uniform(TRAVEL_EDGES_M[travel], min(TRAVEL_EDGES_M[travel + 1], farthest))
    approach = approach_frames(travel_m)
    shortest = next(n for n in range(DURATION_EDGES[duration], 10_000) if _fits(n, approach))
    longest = min(DURATION_EDGES[duration + 1], MOTIONS[kind].max_frames + 1)
    length = int(rng.integers(shortest, max(longest, shortest + 1)))
    window = window_frames(length) if protocol == "observe_before_act" else 0
    return Timing(length, window, approach, float(travel_m))


def kind_table(kind: str) -> np.ndarray:
    """Return (5, 4), the probabilities of duration and travel bins for one kind."""
    names = benchmark_motions()
    if kind in names:
        table = _fitted_table()[names.index(kind)]
    else:
        table = _feasible(kind) * np.outer(DURATION_SHARES, TRAVEL_SHARES)
    return table / table.sum()


@functools.cache
def _fitted_table() -> np.ndarray:
    """(22, 5, 4) joint table whose margins are equal kinds, the durations and the travels of the paper."""
    names = benchmark_motions()
    table = np.stack([_feasible(name) for name in names]).astype(float)
    margins = (np.full(len(names), 1 / len(names)), _normalized(DURATION_SHARES), _normalized(TRAVEL_SHARES))
    for _ in range(400):
        for axis, margin in enumerate(margins):
            others = tuple(a for a in range(3) if a != axis)
            table *= np.expand_dims(margin / table.sum(axis=others), others)
    return table


def _feasible(kind: str) -> np.ndarray:
    """(5, 4) bool: which bins the kind can fill."""
    limit = MOTIONS[kind]
    possible = np.zeros((len(DURATION_SHARES), len(TRAVEL_SHARES)), bool)
    for d, t in np.ndindex(possible.shape):
        longest = min(DURATION_EDGES[d + 1] - 1, limit.max_frames)
        nearest = approach_frames(TRAVEL_EDGES_M[t])
        roomy = approach_frames(TRAVEL_EDGES_M[t + 1])
        tight = min(roomy, limit.max_approach_frames)
        possible[d, t] = longest >= DURATION_EDGES[d] and nearest < limit.max_approach_frames and _fits(longest, tight)
    return possible


def _fits(length: int, approach: int) -> bool:
    return window_frames(length) + approach + MIN_HOLD_FRAMES <= length


def _normalized(shares: tuple[float, ...]) -> np.ndarray:
    return np.asarray(shares) / sum(shares)
