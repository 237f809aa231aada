"""Paired comparison of two evaluations on the same episodes: difference, confidence interval and
p-value.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.conventions import PALM_DOF
from dynahoi_lerobot.evaluate.results import CONDITIONS, Results
from dynahoi_lerobot.evaluate.rows import identity
from dynahoi_lerobot.evaluate.summary import RESAMPLES, SEED, Estimate, bootstrap
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.metrics.columns import COMMANDS
from dynahoi_lerobot.sampling.salt import refuse_mixed_streams, refuse_to_mix

CROSSABLE = tuple(name for name in CONDITIONS if name != "capture")
"""Conditions that may be compared: the same episodes, played under others. Each capture
rule has metrics of its own."""

SIGNIFICANT = 0.05
"""p-value below which a difference is marked; not corrected for the number of comparisons."""


@dataclass(frozen=True)
class Comparison(Estimate):
    """The mean of A - B over the episodes that both played, with the paired bootstrap's 95 %
    interval.

    Of B and A it is the opposite, exactly: value and interval negated, the ends of the interval
    swapped, ``p_value`` and ``n`` the same. Of ``commands`` it is the mean distance, in cm, which
    is the same for B and A.

    Attributes:
        value: the mean, in ``unit``.
        low: lower end of the interval.
        high: upper end of the interval.
        unit: the metric's, or ``cm``.
        n: how many episodes both played and the metric applies to in both.
        p_value: exact McNemar for rates, `sign_flip` for means; two-sided. None for ``commands``.
    """

    value: float
    low: float
    high: float
    p_value: float | None


def refuse_mixture(results: Sequence[Results], *, allow_version_mismatch: bool) -> None:
    """Raise a ValueError for evaluations of different salts, or, unless that is allowed, of
    different versions of the benchmark.
    """
    refuse_mixed_streams((result.folder, result.info.split) for result in results)
    if not allow_version_mismatch:
        versions = [(result.folder, result.info.benchmark) for result in results]
        remedy = "evaluate both under one version, or add --allow-version-mismatch"
        refuse_to_mix("benchmark", versions, remedy)


def unequal_conditions(a: Results, b: Results, across: Collection[str] = ()) -> list[str]:
    """Return the conditions in which two evaluations differ, without the compared ones,
    ``across``.
    """
    return [
        name
        for name in CONDITIONS
        if name not in across and a.conditions[name] != b.conditions[name]
    ]


def compare(
    a: Results,
    b: Results,
    metric: str,
    *,
    across: Collection[str] = (),
    allow_version_mismatch: bool = False,
) -> Comparison | None:
    """Compare two evaluations on one metric, episode by episode; None if no episode has a value of
    both.

    Args:
        a, b: the evaluations.
        metric: name of a registered metric, or ``commands``.
        across: the compared conditions, which may differ; of ``CROSSABLE``.
        allow_version_mismatch: compare them even if they were played under different versions of
            the benchmark.

    Raises:
        ValueError: if the metric is not registered; if another condition or the version differs,
            naming both values; always for different salts.
    """
    refuse_mixture([a, b], allow_version_mismatch=allow_version_mismatch)
    for name in unequal_conditions(a, b, across):
        remedy = (
            f"add --across {name} to compare exactly that"
            if name in CROSSABLE
            else "evaluate both under one"
        )
        refuse_to_mix(name, [(result.folder, result.conditions[name]) for result in (a, b)], remedy)
    return paired_difference(a, b, metric)


def paired_difference(a: Results, b: Results, metric: str) -> Comparison | None:
    """Compare as ``compare`` does, whatever the conditions of both are."""
    if metric == COMMANDS:
        distances = command_distances_cm(a, b)
        if not distances.size:
            return None
        low, high = bootstrap(distances)
        return Comparison(float(distances.mean()), low, high, "cm", len(distances), None)
    pairs = paired_values(a, b, metric)
    return _difference(metric, pairs[:, 0] - pairs[:, 1]) if len(pairs) else None


def verdict(metric: str, found: Comparison | None) -> int:
    """Return 1 if a comparison supports that A is better than B, -1 for worse, 0 for neither."""
    if found is None or not found.value or found.p_value is None or found.p_value >= SIGNIFICANT:
        return 0
    return 1 if (found.value > 0) == (METRICS[metric].direction == "higher") else -1


def paired_values(a: Results, b: Results, metric: str) -> np.ndarray:
    """Return (n, 2) values of ``metric``, in its unit, in the episodes that both have played and
    where it applies, in one order of episodes whichever evaluation comes first.
    """
    pairs = [(a.rows[i].get(metric), b.rows[j].get(metric)) for i, j in _both_played(a, b)]
    return np.array([pair for pair in pairs if None not in pair], np.float64).reshape(-1, 2)


def command_distances_cm(a: Results, b: Results) -> np.ndarray:
    """Return (n,) distances of the palm positions that A and B commanded [cm], of every episode
    that both played.

    Each is a mean over the control frames that both have: an episode ends once its target is
    localized. One without such frames is left out.
    """
    means = []
    for i, j in _both_played(a, b):
        begin = a.rows[i]["window_frames"]  # the same in B: see `identity`
        end = min(len(a.actions[i]), len(b.actions[j]))
        if begin < end:
            palms_m = (actions[begin:end, :PALM_DOF] for actions in (a.actions[i], b.actions[j]))
            means.append(100 * np.linalg.norm(np.subtract(*palms_m), axis=1).mean())
    return np.array(means, np.float64)


def _both_played(a: Results, b: Results) -> list[tuple[int, int]]:
    """Return the place in A and that in B of every episode that both have; the first place, if it
    was played more than once.
    """
    in_a, in_b = (
        {identity(row): place for place, row in reversed([*enumerate(results.rows)])}
        for results in (a, b)
    )
    return [(in_a[key], in_b[key]) for key in sorted(in_a.keys() & in_b.keys())]


def _difference(name: str, differences: np.ndarray) -> Comparison:
    """Return the comparison that (n,) paired ``differences`` in a metric make.

    Seeded resampling of A - B and of B - A would draw different samples. So the differences are
    turned to make the first that is not 0 positive, resampled, and the result is turned back.
    """
    metric = METRICS[name]
    unequal = differences[differences != 0]
    sign = -1.0 if unequal.size and unequal[0] < 0 else 1.0
    forward = sign * differences + 0.0  # no -0.0
    value, *ends = sign * np.array([forward.mean(), *bootstrap(forward)]) + 0.0
    low, high = map(float, sorted(ends))
    p_value = (
        mcnemar(int((forward > 0).sum()), int((forward < 0).sum()))
        if metric.aggregation == "rate"
        else sign_flip(forward)
    )
    return Comparison(float(value), low, high, metric.unit, len(forward), p_value)


def mcnemar(only_a: int, only_b: int) -> float:
    """Return the exact two-sided p-value of McNemar's test from the two discordant counts.

    Under the hypothesis that A and B are equally good, ``only_a`` is binomial(only_a + only_b,
    1/2).
    """
    discordant = only_a + only_b
    tail = sum(math.comb(discordant, k) for k in range(min(only_a, only_b) + 1))
    # whole numbers until the end: 2 ** discordant has no float form beyond 1023
    return min(1.0, 2 * tail / 2**discordant)


def sign_flip(differences: np.ndarray) -> float:
    """Return the two-sided p-value of the paired permutation test that (n,) ``differences`` have
    mean 0.

    If A and B are equally good, each difference might as well be its opposite; the p-value is the
    share of choices of signs whose mean is as far from 0. It is exact for few episodes: of five,
    none is below 2 / 32.
    """
    values = np.sort(differences)
    exact = 2 ** len(differences) <= RESAMPLES
    if exact:
        flipped = np.arange(2 ** len(values))[:, None] >> np.arange(len(values)) & 1  # (2^n, n)
    else:
        flipped = np.random.default_rng(SEED).integers(
            2, size=(RESAMPLES, len(values)), dtype=np.int8
        )
    far = np.abs(values.sum() - 2 * flipped @ values) >= abs(values.sum()) * (1 - 1e-9)
    return float(far.mean() if exact else (far.sum() + 1) / (RESAMPLES + 1))
