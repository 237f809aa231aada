"""Paired comparison of two policies on the same episodes: difference, confidence interval and p-value."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.evaluate.episode_row import IDENTITY, Row
from dynahoi_lerobot.evaluate.intervals import bootstrap_means
from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.foundation.conventions import PALM_DOF
from dynahoi_lerobot.foundation.mixing import refuse_to_mix
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.sampling.salt import refuse_mixed_streams

CROSSABLE = ("protocol", "control_class", "inference", "render_noise")
"""Conditions that may be what is compared: the same episodes, played under others."""

CONDITIONS = ("capture", *CROSSABLE)
"""What must be equal for two evaluations to be paired, unless it is what is compared."""


@dataclass(frozen=True)
class Comparison:
    """Policy A against policy B on the episodes that both played.

    Attributes:
        metric: the compared metric.
        n: paired episodes in which it applies to both.
        difference: mean of A - B, in the metric's unit.
        low: lower end of the paired bootstrap's 95 % interval of the difference.
        high: upper end of that interval.
        p_value: exact McNemar for rates, paired bootstrap for means; two-sided.
    """

    metric: str
    n: int
    difference: float
    low: float
    high: float
    p_value: float


def paired_values(rows_a: Sequence[Row], rows_b: Sequence[Row], metric: str) -> np.ndarray:
    """Return (n, 2) values of ``metric``, in its unit, in the episodes that both have played and where it applies."""
    other = {_identity(row): row[metric] for row in rows_b}
    pairs = ((row[metric], other.get(_identity(row))) for row in rows_a)
    return np.array([pair for pair in pairs if None not in pair], np.float64).reshape(-1, 2)


def unequal_conditions(a: Results, b: Results, across: Collection[str] = ()) -> list[str]:
    """Return the conditions in which two evaluations differ, without those that are compared, ``across``."""
    return [name for name in CONDITIONS if name not in across and getattr(a, name) != getattr(b, name)]


def compare_results(
    a: Results, b: Results, metric: str, *, across: Collection[str] = (), allow_version_mismatch: bool = False
) -> Comparison:
    """Compare two evaluations as `compare` does, if they were played under equal conditions.

    Args:
        a: evaluation A.
        b: evaluation B.
        metric: name of a registered metric.
        across: conditions that may differ, of ``CROSSABLE``: what is compared.
        allow_version_mismatch: see `compare`.

    Raises:
        MixedError: if another condition differs, naming both values.
        ValueError: as `compare`.
    """
    for name in unequal_conditions(a, b, across):
        found = [(result.folder, getattr(result, name)) for result in (a, b)]
        remedy = f"add --across {name} to compare exactly that" if name in CROSSABLE else "evaluate both under one"
        refuse_to_mix(name, found, remedy)
    return compare(a.rows, b.rows, metric, allow_version_mismatch=allow_version_mismatch)


def compare(
    rows_a: Sequence[Row], rows_b: Sequence[Row], metric: str, *, allow_version_mismatch: bool = False
) -> Comparison:
    """Compare two evaluations on one metric, episode by episode.

    Args:
        rows_a: the episodes of policy A.
        rows_b: the episodes of policy B.
        metric: name of a registered metric.
        allow_version_mismatch: compare them even if they were played under different versions of the benchmark.

    Raises:
        UnknownNameError: if the metric is not registered.
        MixedError: if they were, unless that is allowed; always if they are of different salts.
        ValueError: if no episode is in both sets with the metric applying.
    """
    aggregation = METRICS[metric].aggregation
    refuse_mixed_streams((name, row["split"]) for name, rows in (("A", rows_a), ("B", rows_b)) for row in rows)
    if not allow_version_mismatch:
        found = [
            (f"seed {row['seed']} of {name}", row["benchmark"])
            for name, rows in (("A", rows_a), ("B", rows_b))
            for row in rows
        ]
        refuse_to_mix("benchmark", found, "evaluate both under one version, or pass allow_version_mismatch=True")
    pairs = paired_values(rows_a, rows_b, metric)
    if len(pairs) == 0:
        raise ValueError(f"the result sets share no episode with a value of {metric}; evaluate both on the same split")
    differences = pairs[:, 0] - pairs[:, 1]
    means = bootstrap_means(differences)
    low, high = np.percentile(means, [2.5, 97.5])
    only_a, only_b = int((differences > 0).sum()), int((differences < 0).sum())
    p_value = mcnemar(only_a, only_b) if aggregation == "rate" else _tail(means)
    return Comparison(metric, len(pairs), float(differences.mean()), float(low), float(high), p_value)


def command_distances_cm(a: Results, b: Results) -> np.ndarray:
    """Return (n,) distances of the palm positions that A and B commanded [cm], of every episode that both played.

    Each is a mean over the control frames that both have: an episode ends once its target is localised.
    """
    other = {_identity(row): actions for row, actions in zip(b.rows, b.actions, strict=True)}
    means = []
    for row, actions in zip(a.rows, a.actions, strict=True):
        if (paired := other.get(_identity(row))) is not None:
            frames = slice(row["window_frames"], min(len(actions), len(paired)))
            apart_m = np.linalg.norm(actions[frames, :PALM_DOF] - paired[frames, :PALM_DOF], axis=1)
            means.append(100 * apart_m.mean())
    return np.array(means, np.float64)


def mcnemar(only_a: int, only_b: int) -> float:
    """Return the exact two-sided p-value of McNemar's test from the two discordant counts.

    Under the hypothesis that A and B are equally good, ``only_a`` is binomial(only_a + only_b, 1/2).
    """
    discordant = only_a + only_b
    tail = sum(math.comb(discordant, k) for k in range(min(only_a, only_b) + 1))
    # whole numbers until the end: 2 ** discordant has no float form beyond 1023
    return min(1.0, 2 * tail / 2**discordant)


def _tail(means: np.ndarray) -> float:
    """Return the two-sided share of bootstrap means beyond zero, never less than one resample's."""
    far = min((means <= 0).sum(), (means >= 0).sum())
    return float(min(1.0, 2 * max(far, 1) / len(means)))


def _identity(row: Row) -> tuple:
    return tuple(row[name] for name in IDENTITY)
