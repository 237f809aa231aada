"""Paired comparison of two evaluations on the same episodes: difference, confidence interval and p-value."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.compatibility import refuse_to_mix
from dynahoi_lerobot.evaluate.results import RULES, Results
from dynahoi_lerobot.evaluate.rows import IDENTITY, Row
from dynahoi_lerobot.evaluate.summary import bootstrap_means
from dynahoi_lerobot.metrics import METRICS, Metric
from dynahoi_lerobot.sampling.splits import refuse_mixed_streams


@dataclass(frozen=True)
class Comparison:
    """Evaluation A against evaluation B on the episodes that both played.

    Attributes:
        n: paired episodes in which it applies to both.
        difference: mean of A - B, in the metric's unit.
        low: lower end of the paired bootstrap's 95 % interval of the difference.
        high: upper end of that interval.
        p_value: exact McNemar for rates, paired bootstrap for means; two-sided.
    """

    n: int
    difference: float
    low: float
    high: float
    p_value: float


def unequal_conditions(a: Results, b: Results) -> list[str]:
    """Return the conditions in which two evaluations differ."""
    return [name for name in RULES.values() if getattr(a, name) != getattr(b, name)]


def compare(a: Results, b: Results, metric: str, *, allow_version_mismatch: bool = False) -> Comparison | None:
    """Compare two evaluations on one metric, episode by episode; None if no episode has a value of both.

    Args:
        a: evaluation A.
        b: evaluation B.
        metric: name of a registered metric.
        allow_version_mismatch: compare them even if they were played under different versions of the benchmark.

    Raises:
        UnknownNameError: if the metric is not registered.
        MixedError: if a condition or the version differs, naming both values; always for different salts.
    """
    refuse_mixed_streams((result.folder, result.info.split) for result in (a, b))
    if not allow_version_mismatch:
        found = [(result.folder, result.info.benchmark) for result in (a, b)]
        refuse_to_mix("benchmark", found, "evaluate both under one version, or allow the mismatch")
    for name in unequal_conditions(a, b):
        refuse_to_mix(name, [(result.folder, getattr(result, name)) for result in (a, b)], "evaluate both under one")
    differences = -np.diff(paired_values(a, b, metric))[:, 0]
    if len(differences) == 0:
        return None
    means = bootstrap_means(differences)
    low, high = np.percentile(means, [2.5, 97.5])
    p_value = _p_value(METRICS[metric], differences, means)
    return Comparison(len(differences), float(differences.mean()), float(low), float(high), p_value)


def paired_values(a: Results, b: Results, metric: str) -> np.ndarray:
    """Return (n, 2) values of ``metric``, in its unit, in the episodes that both have played and where it applies."""
    other = {_identity(row): row[metric] for row in b.rows}
    pairs = ((row[metric], other.get(_identity(row))) for row in a.rows)
    return np.array([pair for pair in pairs if None not in pair], np.float64).reshape(-1, 2)


def mcnemar(only_a: int, only_b: int) -> float:
    """Return the exact two-sided p-value of McNemar's test from the two discordant counts.

    Under the hypothesis that A and B are equally good, ``only_a`` is binomial(only_a + only_b, 1/2).
    """
    discordant = only_a + only_b
    tail = sum(math.comb(discordant, k) for k in range(min(only_a, only_b) + 1))
    # whole numbers until the end: 2 ** discordant has no float form beyond 1023
    return min(1.0, 2 * tail / 2**discordant)


def _p_value(metric: Metric, differences: np.ndarray, means: np.ndarray) -> float:
    """McNemar's for a rate, else the two-sided share of bootstrap means beyond zero, at least one resample's."""
    if metric.aggregation == "rate":
        return mcnemar(int((differences > 0).sum()), int((differences < 0).sum()))
    far = min((means <= 0).sum(), (means >= 0).sum())
    return float(min(1.0, 2 * max(far, 1) / len(means)))


def _identity(row: Row) -> tuple:
    return tuple(row[name] for name in IDENTITY)
