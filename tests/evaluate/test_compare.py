"""Paired comparisons: exact McNemar by hand, the paired interval, pairing by identity."""

from __future__ import annotations

import pytest

from dynahoi_lerobot.core.compatibility import MixedError
from dynahoi_lerobot.core.registry import UnknownNameError
from dynahoi_lerobot.evaluate.compare import compare, mcnemar, paired_values


def rows(values: list[float | None], metric: str = "S_loc", first_seed: int = 0, **changes: object):
    base = {"split": "test", "kind": "lob", "object": "ball", "length_frames": 40, "benchmark": "v1", **changes}
    return [{**base, "seed": first_seed + i, metric: value} for i, value in enumerate(values)]


@pytest.mark.parametrize(
    ("only_a", "only_b", "p_value"),
    [
        (0, 0, 1.0),
        (3, 3, 1.0),
        (0, 5, 2 / 32),
        (1, 5, 2 * (1 + 6) / 64),
        (8, 2, 2 * (1 + 10 + 45) / 1024),
    ],
)
def test_mcnemar_by_hand(only_a: int, only_b: int, p_value: float):
    assert mcnemar(only_a, only_b) == pytest.approx(p_value)
    assert mcnemar(only_b, only_a) == pytest.approx(p_value)


def test_mcnemar_of_many_episodes_does_not_overflow():
    assert mcnemar(900, 1100) == pytest.approx(8.5e-6, rel=0.1)


def test_rates_are_compared_by_their_discordant_episodes():
    result = compare(rows([1.0] * 6 + [0.0] * 4), rows([1.0] + [0.0] * 9), "S_loc")
    assert (result.n, result.difference) == (10, pytest.approx(0.5))
    assert result.p_value == pytest.approx(2 / 32)
    assert result.low < 0.5 < result.high


def test_a_constant_paired_difference_has_no_spread():
    a, b = rows([1.0, 2.0, 3.0, 9.0], "E_loc"), rows([0.5, 1.5, 2.5, 8.5], "E_loc")
    result = compare(a, b, "E_loc")
    assert (result.difference, result.low, result.high) == (0.5, 0.5, 0.5)
    assert result.p_value < 0.01
    assert compare(b, a, "E_loc").difference == -0.5


def test_equal_policies_do_not_differ():
    a = rows([0.3, 0.9, 0.1], "E_loc")
    result = compare(a, a, "E_loc")
    assert (result.difference, result.low, result.high, result.p_value) == (0.0, 0.0, 0.0, 1.0)


def test_only_the_same_episodes_are_paired_whatever_their_order():
    a, b = rows([1.0, 2.0, 3.0], "E_loc"), rows([20.0, 30.0, 40.0], "E_loc", first_seed=1)
    assert paired_values(a, b[::-1], "E_loc").tolist() == [[2.0, 20.0], [3.0, 30.0]]


@pytest.mark.parametrize("change", [{"split": "val"}, {"kind": "bounce"}, {"object": "egg"}, {"length_frames": 41}])
def test_a_seed_alone_does_not_make_a_pair(change: dict):
    with pytest.raises(ValueError, match="share no episode with a value of S_loc"):
        compare(rows([1.0]), rows([1.0], **change), "S_loc")


def test_conditional_metrics_pair_where_both_apply():
    pairs = paired_values(rows([1.0, None, 0.0], "S_gra"), rows([1.0, 1.0, None], "S_gra"), "S_gra")
    assert pairs.tolist() == [[1.0, 1.0]]


def test_an_unknown_metric_is_named():
    with pytest.raises(UnknownNameError, match="S_lok"):
        compare(rows([1.0]), rows([1.0]), "S_lok")


def test_versions_of_the_benchmark_are_not_compared_unless_asked():
    new, old = rows([1.0, 1.0]), rows([0.0, 1.0], benchmark="v0")
    with pytest.raises(
        MixedError, match=r"seed 0 of A has benchmark 'v1', seed 0 of B has benchmark 'v0'; evaluate both"
    ):
        compare(new, old, "S_loc")
    assert compare(new, old, "S_loc", allow_version_mismatch=True).difference == pytest.approx(0.5)
