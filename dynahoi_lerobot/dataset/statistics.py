"""Statistics of columns and images in LeRobot's schema: min, max, mean, std, count and five quantiles.

LeRobot averages the quantiles of episodes, so its ``q01`` depends on how frames were grouped. Ours are order statistics
of the whole dataset: the smallest value with at least a share q of all values at or below it. Radix selection on the
bit patterns of float32 finds them in a few passes and bounded memory. Its counts are integers, so neither the order of
the frames nor the number of files changes the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import cv2
import numpy as np

PERCENTS = {"q01": 1, "q10": 10, "q50": 50, "q90": 90, "q99": 99}
"""LeRobot's quantiles and their percentages."""

DIGITS = ((21, 11), (10, 11), (0, 10))
"""The 32 bits of a key as (shift, width) of three digits, high to low."""


def rank(percent: int, count: int) -> int:
    """Return the 1-based rank of a percentile among ``count`` values, in integers so that nothing rounds."""
    return max(1, -(-percent * count // 100))


def sorted_quantiles(ordered: np.ndarray) -> dict[str, np.ndarray]:
    """Return the quantiles of values sorted along axis 0, (T, D) -> (D,) each."""
    return {name: ordered[rank(percent, len(ordered)) - 1] for name, percent in PERCENTS.items()}


def weighted_quantiles(values: np.ndarray, counts: np.ndarray) -> dict[str, float]:
    """Return the quantiles of (K,) sorted ``values``, each occurring ``counts`` times."""
    below = np.cumsum(counts)
    return {
        name: float(values[np.searchsorted(below, rank(percent, int(below[-1])))]) for name, percent in PERCENTS.items()
    }


def exact_quantiles(batches: Callable[[], Iterable[np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the quantiles of each column of a dataset that need not fit into memory.

    Args:
        batches: returns an iterator over (n, D) float32 arrays; called once per digit.

    Returns:
        (D,) float32 per quantile name.
    """
    width, count = _shape(batches())
    ranks = {name: rank(percent, count) for name, percent in PERCENTS.items()}
    searches = {(column, name): (0, wanted) for column in range(width) for name, wanted in ranks.items()}
    for shift, bits in DIGITS:
        wanted = {(column, prefix) for (column, _), (prefix, _) in searches.items()}
        counts = _digit_counts(batches(), sorted(wanted), shift, bits)
        for search, (prefix, remaining) in searches.items():
            below = np.cumsum(counts[search[0], prefix])
            digit = int(np.searchsorted(below, remaining))
            before = int(below[digit - 1]) if digit else 0
            searches[search] = (prefix << bits | digit, remaining - before)
    found = {name: [searches[column, name][0] for column in range(width)] for name in PERCENTS}
    return {name: _values(np.array(keys, np.uint64)) for name, keys in found.items()}


def _shape(batches: Iterable[np.ndarray]) -> tuple[int, int]:
    """Return the number of columns and of values in each."""
    shapes = [batch.shape for batch in batches]
    if not shapes or not (count := sum(rows for rows, _ in shapes)):
        raise ValueError("quantiles of no values at all; at least one frame is needed")
    return shapes[0][1], count


def _digit_counts(
    batches: Iterable[np.ndarray], wanted: list[tuple[int, int]], shift: int, bits: int
) -> dict[tuple[int, int], np.ndarray]:
    """Count the next digit of the values that share each wanted (column, prefix)."""
    size = 1 << bits
    counts = {key: np.zeros(size, np.int64) for key in wanted}
    for batch in batches:
        keys = _keys(batch)  # (n, D)
        for column, prefix in wanted:
            values = keys[:, column]
            inside = values[values >> np.uint64(shift + bits) == prefix]
            digits = (inside >> np.uint64(shift)) & np.uint64(size - 1)
            counts[column, prefix] += np.bincount(digits.astype(np.intp), minlength=size)
    return counts


def _keys(values: np.ndarray) -> np.ndarray:
    """Map float32 to integers below 2^32 that sort as the numbers do; -0 becomes 0."""
    bits = (values.astype(np.float32) + np.float32(0)).view(np.uint32)
    return np.where(bits >> 31 == 1, ~bits, bits | np.uint32(1 << 31)).astype(np.uint64)


def _values(keys: np.ndarray) -> np.ndarray:
    """Undo ``_keys``."""
    keys = keys.astype(np.uint32)
    bits = np.where(keys >> 31 == 1, keys & np.uint32((1 << 31) - 1), ~keys)
    return bits.astype(np.uint32).view(np.float32)


Stats = dict[str, np.ndarray]

NAMES = ("min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99")
"""LeRobot's statistics, in its order."""

LEVELS = 256
LARGE_IMAGE = 300
SMALL_IMAGE = 150
"""LeRobot thins images of LARGE_IMAGE pixels or more to about SMALL_IMAGE before it counts."""


def column_stats(values: np.ndarray) -> Stats:
    """Return the statistics of a (T, D) array along time, each (D,), computed in float64."""
    values = np.asarray(values, np.float64)
    return {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        "count": np.array([len(values)]),
        **sorted_quantiles(np.sort(values, axis=0)),
    }


def table_stats(arrays: dict[str, np.ndarray]) -> dict[str, Stats]:
    """Return ``column_stats`` of several (T, D) or (T,) arrays at once: one pass over one wide matrix."""
    wide = {key: values.reshape(len(values), -1) for key, values in arrays.items()}  # (T, D)
    stats = column_stats(np.concatenate(list(wide.values()), axis=1, dtype=np.float64, casting="unsafe"))
    edges = np.cumsum([0, *(values.shape[1] for values in wide.values())])
    return {
        key: {name: value if name == "count" else value[start:stop] for name, value in stats.items()}
        for key, start, stop in zip(wide, edges[:-1], edges[1:], strict=True)
    }


def sampled_frames(frames: int) -> np.ndarray:
    """Return the frames whose images LeRobot counts: all up to 100, then about ``frames ** 0.75``."""
    count = max(min(frames, 100), min(int(frames**0.75), 10_000))
    return np.round(np.linspace(0, frames - 1, count)).astype(int)


def picture_histogram(images: np.ndarray) -> np.ndarray:
    """Count the levels of each channel.

    Args:
        images: (N, H, W, 3) uint8 RGB.

    Returns:
        (3, 256) int64.
    """
    size = max(images.shape[1:3])
    step = size // SMALL_IMAGE if size >= LARGE_IMAGE else 1
    tall = np.ascontiguousarray(images[:, ::step, ::step]).reshape(-1, 1, 3)  # (N H W, 1, 3)
    counts = [cv2.calcHist([tall], [channel], None, [LEVELS], [0, LEVELS]) for channel in range(3)]
    return np.concatenate(counts, axis=1).T.astype(np.int64)  # (3, 256), exact up to 2^24 pixels of a level


def picture_stats(histogram: np.ndarray, count: int) -> Stats:
    """Return the exact statistics of ``count`` images from their (3, 256) counts, (3, 1, 1) in 0-1."""
    levels = np.arange(LEVELS) / (LEVELS - 1)
    total = histogram.sum(axis=1)
    mean = histogram @ levels / total
    spread = (levels - mean[:, None]) ** 2  # (3, 256)
    quantiles = [weighted_quantiles(levels, channel) for channel in histogram]
    seen = [levels[channel > 0] for channel in histogram]
    stats = {
        "min": np.array([values[0] for values in seen]),
        "max": np.array([values[-1] for values in seen]),
        "mean": mean,
        "std": np.sqrt((histogram * spread).sum(axis=1) / total),
        **{name: np.array([channel[name] for channel in quantiles]) for name in quantiles[0]},
    }
    shaped = {name: value.reshape(3, 1, 1) for name, value in stats.items()}
    return {name: np.array([count]) if name == "count" else shaped[name] for name in NAMES}


class Moments:
    """Mean, spread and range of many episodes, added one by one in the episodes' order."""

    def __init__(self) -> None:
        """Start with nothing."""
        self.count = 0
        self._mean: Any = 0.0
        self._square: Any = 0.0
        self._low: Any = np.inf
        self._high: Any = -np.inf

    def add(self, stats: Stats) -> None:
        """Add one episode's statistics (the pairwise update of Chan, Golub and LeVeque)."""
        added = int(stats["count"][0])
        total = self.count + added
        step = stats["mean"] - self._mean
        self._mean = self._mean + step * (added / total)
        self._square = self._square + stats["std"] ** 2 * added + step**2 * (self.count * added / total)
        self._low = np.minimum(self._low, stats["min"])
        self._high = np.maximum(self._high, stats["max"])
        self.count = total

    def stats(self, quantiles: Stats) -> Stats:
        """Return the statistics of everything added, with the given quantiles."""
        return {
            "min": self._low,
            "max": self._high,
            "mean": self._mean,
            "std": np.sqrt(self._square / self.count),
            "count": np.array([self.count]),
            **quantiles,
        }
