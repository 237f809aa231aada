"""Exact quantiles of any amount of data in a few passes and bounded memory.

LeRobot averages the quantiles of episodes, so its ``q01`` depends on how frames were grouped. These are
order statistics of the whole dataset: the smallest value with at least a share q of all values at or below
it. They are found by radix selection on the bit patterns of float32, whose counts are integers: neither the
order of the frames nor the number of files changes the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

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
