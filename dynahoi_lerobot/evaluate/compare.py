"""Paired comparison of two evaluations on the same episodes: difference, confidence interval and
p-value.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.conventions import PALM_DOF
from dynahoi_lerobot.evaluate.results import CONDITIONS, Results
from dynahoi_lerobot.evaluate.rows import identity
from dynahoi_lerobot.evaluate.summary import RESAMPLES, SEED, Estimate, bootstrap
from dynahoi_lerobot.metrics import METRICS, Metric
from dynahoi_lerobot.sampling.salt import refuse_mixed_streams, refuse_to_mix

CROSSABLE = tuple(name for name in CONDITIONS if name != "capture")
"""Conditions that may be compared: the same episodes, played under others. Each capture
rule has metrics of its own."""

COMMANDS = "commands"
"""Compared beside the metrics: how far apart two evaluations command the palm."""

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
    refuse_mixed_streams((result.folder, result.info.split) for result in (a, b))
    if not allow_version_mismatch:
        found = [(result.folder, result.info.benchmark) for result in (a, b)]
        refuse_to_mix("benchmark", found, "evaluate both under one version, or allow the mismatch")
    for name in unequal_conditions(a, b, across):
        remedy = (
            f"add --across {name} to compare exactly that"
            if name in CROSSABLE
            else "evaluate both under one"
        )
        refuse_to_mix(name, [(result.folder, result.conditions[name]) for result in (a, b)], remedy)
    differences = (
        command_distances_cm(a, b)
        if metric == COMMANDS
        else -np.diff(paired_values(a, b, metric))[:, 0]
    )
    if len(differences) == 0:
        return None
    if metric == COMMANDS:
        low, high = bootstrap(differences)
        return Comparison(float(differences.mean()), low, high, "cm", len(differences), None)
    return _difference(METRICS[metric], differences)


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
    localized.
    """
    means = []
    for i, j in _both_played(a, b):
        frames = slice(a.rows[i]["window_frames"], min(len(a.actions[i]), len(b.actions[j])))
        apart_m = np.linalg.norm(
            a.actions[i][frames, :PALM_DOF] - b.actions[j][frames, :PALM_DOF], axis=1
        )
        means.append(100 * apart_m.mean())
    return np.array(means, np.float64)


def _both_played(a: Results, b: Results) -> list[tuple[int, int]]:
    """Return the place in A and that in B of every episode that both have; the first place, if it
    was played more than once.
    """
    in_a = _places(a)
    in_b = _places(b)
    return [(in_a[key], in_b[key]) for key in sorted(in_a.keys() & in_b.keys())]


def _places(results: Results) -> dict[tuple, int]:
    places: dict[tuple, int] = {}
    for place, row in enumerate(results.rows):
        places.setdefault(identity(row), place)
    return places


def _difference(metric: Metric, differences: np.ndarray) -> Comparison:
    """Return the comparison that (n,) paired ``differences`` make.

    Seeded resampling of A - B and of B - A would draw different samples. So the differences are
    turned to make the first that is not 0 positive, resampled, and the result is turned back.
    """
    unequal = differences[differences != 0]
    turned = unequal.size > 0 and unequal[0] < 0
    forward = (-differences if turned else differences) + 0.0  # no -0.0
    value = float(forward.mean())
    n = len(forward)
    low, high = bootstrap(forward)
    p_value = _p_value(metric, forward)
    if turned:
        value, low, high = 0.0 - value, 0.0 - high, 0.0 - low
    return Comparison(value, low, high, metric.unit, n, p_value)


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


def _p_value(metric: Metric, differences: np.ndarray) -> float:
    if metric.aggregation == "rate":
        return mcnemar(int((differences > 0).sum()), int((differences < 0).sum()))
    return sign_flip(differences)
