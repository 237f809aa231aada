"""How long episodes last and how far the hand travels: drawn so that all kinds together give the
paper's histograms.

Motions that end soon (a throw lasts under a second) cannot fill the long bins, so the others must.
The joint table of kind, duration bin and travel bin is the one closest to independence whose three
margins are those of the benchmark (iterative proportional fitting).
"""

import functools
import itertools
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.conventions import (
    CONTROL_DT,
    INTERCEPT_SPEED_M_S,
    MIN_WINDOW_FRAMES,
    WINDOW_FRACTION,
    frames_until,
)
from dynahoi_lerobot.core.numerics import cbrt
from dynahoi_lerobot.core.protocols import PROTOCOLS
from dynahoi_lerobot.motions import MOTIONS, Motion
from dynahoi_lerobot.sampling.benchmark import BENCHMARK

MIN_APPROACH_FRAMES = 5
"""Earliest intercept after the control start: the fingers need 0.25 s to close."""
MIN_GRASP_FRAMES = 6
"""Shortest recording after the intercept."""
FITTING_SWEEPS = 400
BENCHMARK_KINDS = BENCHMARK.splits["train"].motions


@dataclass(frozen=True)
class Timing:
    """Frames and travel of one episode.

    Attributes:
        length_frames: L, length of the expert's recording.
        window_frames: length of the observation window, 0 for ``direct_act``.
        approach_frames: from the control start to the intercept.
        travel_m: straight distance from the hand's home to the intercept.
    """

    length_frames: int
    window_frames: int
    approach_frames: int
    travel_m: float

    @property
    def intercept_frame(self) -> int:
        """Frame of the intercept, counted from the start of the episode."""
        return self.window_frames + self.approach_frames

    @property
    def path_frames(self) -> int:
        """Frames over which the target's path must be known: the window, L control steps and the
        last state.
        """
        return self.window_frames + self.length_frames + 1


def window_frames(length_frames: int) -> int:
    """Return the length of the observation window: the first 20 % of the frames, at least 8."""
    return max(MIN_WINDOW_FRAMES, int(np.ceil(WINDOW_FRACTION * length_frames)))


def approach_frames(travel_m: float) -> int:
    """Return how many frames the hand needs for ``travel_m`` [m] at its fixed speed, at least 5."""
    return max(MIN_APPROACH_FRAMES, frames_until(travel_m / INTERCEPT_SPEED_M_S))


def draw_timing(kind: str, protocol: str, rng: np.random.Generator) -> Timing:
    """Draw duration and travel of one episode of a kind of motion under one of
    ``protocols.PROTOCOLS``.
    """
    table = kind_table(kind)
    duration, travel = np.unravel_index(rng.choice(table.size, p=table.ravel()), table.shape)
    travel_m = _draw_travel(MOTIONS[kind], int(travel), rng)
    approach = approach_frames(travel_m)
    length = _draw_length(MOTIONS[kind], int(duration), approach, rng)
    window = window_frames(length) if PROTOCOLS[protocol].has_window else 0
    return Timing(length, window, approach, travel_m)


def _draw_travel(motion: type[Motion], travel_bin: int, rng: np.random.Generator) -> float:
    """Travel [m] in its bin, up to what the hand can cover before the motion's latest intercept.

    Homes are spread evenly over the volume of the bin's shell: spread evenly over distance they
    would crowd around the intercept, where a hand that sees nothing meets most targets.
    """
    low, high = BENCHMARK.travels.edges[travel_bin : travel_bin + 2]
    high = min(high, motion.max_approach_frames * INTERCEPT_SPEED_M_S * CONTROL_DT)
    return float(cbrt(rng.uniform(low**3, high**3)))


def _draw_length(
    motion: type[Motion], duration_bin: int, approach: int, rng: np.random.Generator
) -> int:
    """L, uniform in its bin between what window, approach and grasp need and what the motion
    allows.
    """
    low, high = (int(edge) for edge in BENCHMARK.durations.edges[duration_bin : duration_bin + 2])
    shortest = next(length for length in itertools.count(low) if _fits(length, approach))
    return int(rng.integers(shortest, max(min(high, motion.max_frames + 1), shortest + 1)))


def kind_table(kind: str) -> np.ndarray:
    """Return (D, T) probabilities of the duration and travel bins for one kind of motion.

    A kind outside the benchmark's 22 gets the benchmark's shares over the bins that it can fill.
    """
    if kind in BENCHMARK_KINDS:
        table = _fitted_table()[BENCHMARK_KINDS.index(kind)]
    else:
        table = _feasible(kind) * np.outer(BENCHMARK.durations.shares, BENCHMARK.travels.shares)
    return table / table.sum()


@functools.cache
def _fitted_table() -> np.ndarray:
    """(22, D, T) joint table whose margins are equal kinds and the benchmark's durations and
    travels.
    """
    table = np.stack([_feasible(kind) for kind in BENCHMARK_KINDS]).astype(float)
    shares = (np.ones(len(BENCHMARK_KINDS)), BENCHMARK.durations.shares, BENCHMARK.travels.shares)
    margins = [np.divide(share, sum(share)) for share in shares]
    for _ in range(FITTING_SWEEPS):
        for axis, margin in enumerate(margins):
            others = tuple(a for a in range(3) if a != axis)
            table *= np.expand_dims(margin / table.sum(axis=others), others)
    return table


def _feasible(kind: str) -> np.ndarray:
    """(D, T) bool: which bins the kind can fill."""
    motion = MOTIONS[kind]
    durations = BENCHMARK.durations.edges
    travels = BENCHMARK.travels.edges
    possible = np.zeros((len(durations) - 1, len(travels) - 1), bool)
    for d, t in np.ndindex(possible.shape):
        longest = min(int(durations[d + 1]) - 1, motion.max_frames)
        nearest = approach_frames(travels[t])
        farthest = approach_frames(travels[t + 1])
        approach = min(farthest, motion.max_approach_frames)
        in_time = nearest < motion.max_approach_frames
        possible[d, t] = longest >= durations[d] and in_time and _fits(longest, approach)
    return possible


def _fits(length: int, approach: int) -> bool:
    return window_frames(length) + approach + MIN_GRASP_FRAMES <= length
