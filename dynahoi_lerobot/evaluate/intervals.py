"""Confidence intervals, 95 %: Wilson's for rates, the percentile bootstrap's for means."""

from __future__ import annotations

import math

import numpy as np

Z_95 = 1.959963984540054
"""Two-sided 95 % quantile of the standard normal distribution."""

RESAMPLES = 2000
SEED = 0
_CHUNK = 2_000_000  # resampled values held at once, so that memory stays bounded for any number of episodes


def wilson(successes: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % score interval of a rate, within [0, 1].

    Unlike the normal interval it is not empty at 0 or at ``count`` successes (E. B. Wilson, JASA 1927).

    Raises:
        ValueError: unless ``0 <= successes <= count`` and ``count > 0``.
    """
    if not 0 <= successes <= count or count == 0:
        raise ValueError(f"a rate needs 0 <= successes <= count and count > 0, not {successes} of {count}")
    rate, spread = successes / count, Z_95**2 / count
    centre = (rate + spread / 2) / (1 + spread)
    half = math.sqrt(rate * (1 - rate) * spread + spread**2 / 4) / (1 + spread)
    # at the ends the interval touches 0 or 1 exactly; rounding must not push it past the rate
    return max(0.0, min(centre - half, rate)), min(1.0, max(centre + half, rate))


def bootstrap_means(values: np.ndarray, resamples: int = RESAMPLES, seed: int = SEED) -> np.ndarray:
    """Return (resamples,) means of resamples with replacement of (n,) ``values``, independent of their order.

    Raises:
        ValueError: if there is no value.
    """
    values = np.sort(np.asarray(values, np.float64))
    if values.size == 0:
        raise ValueError("a bootstrap needs at least one value, got none")
    rng = np.random.default_rng(seed)
    rows = max(1, _CHUNK // values.size)
    counts = [min(rows, resamples - start) for start in range(0, resamples, rows)]
    picks = (rng.integers(values.size, size=(count, values.size)) for count in counts)
    return np.concatenate([values[pick].mean(axis=1) for pick in picks])


def bootstrap(values: np.ndarray, resamples: int = RESAMPLES, seed: int = SEED) -> tuple[float, float]:
    """Return the seeded 95 % percentile interval of the mean of (n,) ``values``, in their unit."""
    low, high = np.percentile(bootstrap_means(values, resamples, seed), [2.5, 97.5])
    return float(low), float(high)
