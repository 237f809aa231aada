"""Aggregation: every metric with its confidence interval, over all episodes or by stratum."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.evaluate.episode_row import Row, episode_row
from dynahoi_lerobot.evaluate.intervals import bootstrap, wilson
from dynahoi_lerobot.evaluate.strata import STRATA
from dynahoi_lerobot.metrics import METRICS, Metric


@dataclass(frozen=True)
class Estimate:
    """A mean over episodes with its 95 % interval.

    Attributes:
        value: the mean, in ``unit``; None if no episode meets the metric's condition.
        low: lower end of the interval, None with ``value``.
        high: upper end of the interval, None with ``value``.
        unit: ``fraction``, ``u`` (0.1 m) or ``score``.
        n: how many episodes meet the metric's condition.
    """

    value: float | None
    low: float | None
    high: float | None
    unit: str
    n: int

    def as_json(self) -> dict[str, Any]:
        """Return the fields as a dictionary."""
        return asdict(self)


Summary = dict[str, Estimate]


def estimate(metric: Metric, values: Iterable[float | None]) -> Estimate:
    """Return the mean of one metric over the episodes where it applies (a None is left out).

    Rates get Wilson's interval, means the seeded bootstrap's.
    """
    known = np.array([value for value in values if value is not None], np.float64)
    if known.size == 0:
        return Estimate(None, None, None, metric.unit, 0)
    ends = wilson(int(known.sum()), known.size) if metric.aggregation == "rate" else bootstrap(known)
    return Estimate(float(known.mean()), *ends, metric.unit, int(known.size))


def summarise(episodes: Iterable[Episode]) -> Summary:
    """Return every metric over ``episodes``, which may be a generator: only their rows are kept."""
    return summarise_rows([episode_row(episode) for episode in episodes])


def summarise_rows(rows: Sequence[Row]) -> Summary:
    """Return every metric over ``rows``; a metric without a column there has ``n = 0``."""
    return {name: estimate(metric, (row.get(name) for row in rows)) for name, metric in METRICS.items()}


def split_rows(rows: Sequence[Row], stratum: str) -> dict[str, list[Row]]:
    """Return the rows of every label of ``stratum``, in the stratum's order.

    Raises:
        ValueError: if there is no such stratum.
    """
    if stratum not in STRATA:
        raise ValueError(f"unknown stratum {stratum!r}; known: {', '.join(STRATA)}")
    labels = STRATA[stratum].arrange({row[stratum] for row in rows})
    return {label: [row for row in rows if row[stratum] == label] for label in labels}


def summarise_by(rows: Sequence[Row], stratum: str) -> dict[str, Summary]:
    """Return every metric for every label of ``stratum``, in the stratum's order."""
    return {label: summarise_rows(group) for label, group in split_rows(rows, stratum).items()}
