"""Every metric with its 95 % interval, over all episodes or by group: Wilson's for rates, the
bootstrap's for means.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.evaluate.rows import Row
from dynahoi_lerobot.metrics import METRICS, Metric
from dynahoi_lerobot.metrics.columns import STRATA

Z_95 = 1.959963984540054
"""Two-sided 95 % quantile of the standard normal distribution."""
RESAMPLES = 2000
SEED = 0
RESAMPLED_AT_ONCE = 2_000_000
"""Values resampled at once, which bounds memory for any number of episodes."""


def wilson(successes: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % score interval of a rate, within [0, 1].

    Unlike the normal approximation's, it has a width at 0 and at ``count`` successes (E. B. Wilson,
    JASA 1927).
    """
    rate = successes / count
    spread = Z_95**2 / count
    center = (rate + spread / 2) / (1 + spread)
    half = math.sqrt(rate * (1 - rate) * spread + spread**2 / 4) / (1 + spread)
    # at the ends the interval touches 0 or 1 exactly; rounding must not push it past the rate
    return max(0.0, min(center - half, rate)), min(1.0, max(center + half, rate))


def bootstrap(values: np.ndarray) -> tuple[float, float]:
    """Return the seeded 95 % percentile interval of the mean of (n,) ``values``, in their unit, the
    same for any order of the values.
    """
    values = np.sort(np.asarray(values, np.float64))
    rng = np.random.default_rng(SEED)
    at_once = max(1, RESAMPLED_AT_ONCE // values.size)
    means = []
    for start in range(0, RESAMPLES, at_once):
        count = min(at_once, RESAMPLES - start)
        picks = rng.integers(values.size, size=(count, values.size))
        means.append(values[picks].mean(axis=1))
    low, high = np.percentile(np.concatenate(means), [2.5, 97.5])
    return float(low), float(high)


@dataclass(frozen=True)
class Estimate:
    """A mean over episodes with its 95 % interval.

    Attributes:
        value: the mean, in ``unit``; None if no episode meets the metric's condition.
        low: lower end of the interval, None with ``value``.
        high: upper end of the interval, None with ``value``.
        unit: ``fraction``, ``u`` (0.1 m), ``m/s`` or ``score``.
        n: how many episodes meet the metric's condition.
    """

    value: float | None
    low: float | None
    high: float | None
    unit: str
    n: int

    def shown(self) -> list[float]:
        """Return value and ends of the interval as people read them, fractions in per cent; empty
        without a value.
        """
        scale = 100 if self.unit == "fraction" else 1
        return [scale * end for end in (self.value, self.low, self.high) if end is not None]


Summary = dict[str, Estimate]


def estimate(metric: Metric, values: Iterable[float | None]) -> Estimate:
    """Return the mean of one metric over the episodes to which it applies, those whose value is not
    None.
    """
    known = np.array([value for value in values if value is not None], np.float64)
    if known.size == 0:
        return Estimate(None, None, None, metric.unit, 0)
    ends = (
        wilson(int(known.sum()), known.size) if metric.aggregation == "rate" else bootstrap(known)
    )
    return Estimate(float(known.mean()), *ends, metric.unit, int(known.size))


def summarize_rows(rows: Sequence[Row]) -> Summary:
    """Return every metric over ``rows``; a metric that the rows lack has ``n = 0``."""
    return {
        name: estimate(metric, (row.get(name) for row in rows)) for name, metric in METRICS.items()
    }


def summarize_by(rows: Sequence[Row], stratum: str) -> dict[str, Summary]:
    """Return every metric for every label of ``stratum``, in the stratum's order."""
    labels = STRATA[stratum].arrange({row[stratum] for row in rows})
    return {
        label: summarize_rows([row for row in rows if row[stratum] == label]) for label in labels
    }
