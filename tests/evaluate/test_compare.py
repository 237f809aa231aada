"""Paired comparisons: exact McNemar, the paired interval, pairing by identity, under equal
conditions.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate.compare import (
    CROSSABLE,
    Comparison,
    compare,
    mcnemar,
    paired_values,
    sign_flip,
)
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.metrics.columns import COMMANDS
from dynahoi_lerobot.sampling.recipe import COMPARED
from dynahoi_lerobot.sampling.salt import stream_label
from tests.synthetic import run_info

IDENTITY = {
    "split": "test",
    "kind": "lob",
    "object": "ball",
    "length_frames": 40,
    "intercept": "3000 0 -200",
}


def results(
    values: list, metric: str = "S_loc", first_seed: int = 0, folder: str = "a", **changes
) -> Results:
    """Results with one row a value; ``changes`` go into the rows, or where the condition of that
    name is.
    """
    told = {name: changes.pop(name) for name in (*COMPARED, "benchmark") if name in changes}
    extra = {"inference": changes.pop("inference", "")}
    if "path_speed" in told:
        told["split"] = "twins"
    info = run_info("p", extra=extra, salt=changes.pop("salt", ""), **told)
    base = {**IDENTITY, "window_frames": 8, **changes}
    rows = tuple({**base, "seed": first_seed + i, metric: value} for i, value in enumerate(values))
    return Results(Path(folder), info, rows, tuple(np.zeros((12, 18), np.float32) for _ in rows))


def test_mcnemar_is_the_binomial_test_of_the_discordant_episodes():
    for only_a, only_b in [*np.ndindex(9, 9), (900, 1100)]:
        wanted = binomtest(only_a, only_a + only_b).pvalue if only_a + only_b else 1.0
        assert mcnemar(only_a, only_b) == pytest.approx(wanted)


def test_means_of_few_episodes_are_never_significant_and_chance_is_seldom():
    for n in range(1, 6):
        assert sign_flip(np.linspace(0.9, 1.1, n)) == 2 / 2**n > 0.05
    assert (
        sign_flip(np.array([3.0, 1.0, -2.0])) == 0.75
    )  # all but two of eight sums are as far from 0
    assert sign_flip(np.full(40, 0.1)) == 1 / 2001
    by_chance = [
        sign_flip(np.random.default_rng(seed).normal(size=n)) < 0.05
        for n in (8, 20)
        for seed in range(300)
    ]
    assert 0.02 < np.mean(by_chance) < 0.08


def test_rates_are_compared_by_their_discordant_episodes():
    found = compare(results([1.0] * 6 + [0.0] * 4), results([1.0] + [0.0] * 9), "S_loc")
    assert (found.n, found.value) == (10, pytest.approx(0.5))
    assert found.p_value == pytest.approx(2 / 32)
    assert found.low < 0.5 < found.high


def test_a_constant_paired_difference_has_no_spread():
    a = results([1.0, 2.0, 3.0, 9.0], "E_loc")
    b = results([0.5, 1.5, 2.5, 8.5], "E_loc")
    assert compare(a, b, "E_loc") == Comparison(0.5, 0.5, 0.5, "u", 4, 2 / 16)
    assert compare(a, a, "E_loc") == Comparison(0.0, 0.0, 0.0, "u", 4, 1.0)


def test_commands_are_as_far_apart_as_the_palms_in_the_control_frames_that_both_have():
    a = results([1.0, 1.0])
    b = results([1.0, 1.0])
    for actions, offset_m in zip(b.actions, (0.03, 0.05), strict=True):
        actions[8:, :3] += (0.0, offset_m, 0.0)
        actions[:8], actions[:, 3:] = 9.0, 9.0  # neither the window nor the fingers count
    shorter = Results(b.folder, b.info, b.rows, (b.actions[0][:10], b.actions[1]))
    for other in (b, shorter):
        found = compare(a, other, COMMANDS)
        assert (found.n, found.value, found.low, found.high) == pytest.approx((2, 4.0, 3.0, 5.0))
        assert compare(other, a, COMMANDS) == found


def test_an_episode_that_ends_with_its_window_has_no_commands_to_compare():
    a = results([1.0, 1.0])
    b = results([1.0, 1.0])
    b = replace(b, actions=(b.actions[0], b.actions[1][:8]))  # the second ends with its window
    b.actions[0][8:, :3] += (0.0, 0.03, 0.0)
    found = compare(a, b, COMMANDS)
    assert (found.n, found.value) == (1, pytest.approx(3.0))
    assert compare(b, a, COMMANDS) == found


def test_the_same_episodes_are_paired_and_others_of_the_same_seeds_are_not(tmp_path):
    """By a baseline that does the same in the same episode."""

    def played(name: str, *options: str) -> Results:
        out = tmp_path / name
        run = ("evaluate", "--policy", "pursuit", "--split", "val", "--episodes", "44")
        assert main([*run, *options, "--out", str(out)]) == 0
        return read_results(out)

    everything = played("all")
    fewer = compare(everything, played("ball", "--objects", "ball,cup,bottle"), COMMANDS)
    assert fewer is not None
    assert (fewer.value, fewer.high) == (0.0, 0.0)
    direct = played("direct", "--protocol", "direct_act")
    assert not len(paired_values(everything, direct, "S_loc")), "the paths depend on the window"
    late = played("late", "--control-class", "late")
    assert len(paired_values(everything, late, "S_loc")) == 44


def test_only_the_same_episodes_are_paired():
    a = results([1.0, 2.0, 3.0], "E_loc")
    b = results([20.0, 30.0, 40.0], "E_loc", first_seed=1)
    assert paired_values(a, b, "E_loc").tolist() == [[2.0, 20.0], [3.0, 30.0]]
    conditional = results([1.0, None, 0.0], "S_gra"), results([1.0, 1.0, None], "S_gra")
    assert paired_values(*conditional, "S_gra").tolist() == [[1.0, 1.0]]


def test_a_seed_alone_does_not_make_a_pair_and_an_unknown_metric_is_named():
    for change in (
        {"split": "val"},
        {"kind": "bounce"},
        {"object": "egg"},
        {"length_frames": 41},
        {"intercept": "3000 1 -200"},
    ):
        assert compare(results([1.0]), results([1.0], **change), "S_loc") is None
    with pytest.raises(ValueError, match="S_lok"):
        compare(results([1.0], "S_lok"), results([1.0], "S_lok"), "S_lok")


def split_digits(salt: str) -> str:
    """What names the stream of a salt."""
    return stream_label("", salt).removeprefix("+")


def drawn_pair(metric: str, seed: int) -> tuple[Results, Results]:
    """Two evaluations with overlapping episodes, ties and gaps."""
    rng = np.random.default_rng(seed)
    values = rng.integers(2, size=(2, 30)) if metric[0] == "S" else rng.exponential(1.0, (2, 30))
    mine, others = values.astype(float).tolist()
    others[:5] = mine[3:8]
    mine[7] = others[9] = None
    return results(mine, metric), results(others, metric, first_seed=3)


@pytest.mark.parametrize("metric", ["S_loc", "S_gra", "E_loc", "R_time"])
def test_a_comparison_is_exactly_the_opposite_of_the_reverse_in_any_order(metric: str):
    for seed in range(12):
        a, b = drawn_pair(metric, seed)
        found = compare(a, b, metric)
        turned = compare(b, a, metric)
        assert found == replace(turned, value=-turned.value, low=-turned.high, high=-turned.low)
        assert "-0.0," not in repr((found, turned))
        backwards = replace(b, rows=b.rows[::-1], actions=b.actions[::-1])
        assert compare(a, backwards, metric) == found
        repeated = replace(a, rows=(*a.rows, a.rows[4] | {metric: 0.5}))
        assert compare(repeated, b, metric) == found, "the first time counts"


@pytest.mark.parametrize(
    "other",
    [
        {"protocol": "direct_act"},
        {"control_class": "late"},
        {"inference": "async 150 ms"},
        {"render_noise": 2},
        {"path_speed": 1.6},
        {"instructions": "reveal"},
        {"appearance": ("lights", "distractors")},
        {"capture": "contact"},
        {"benchmark": "v0"},
        {"salt": "as long as a salt must be"},
    ],
)
def test_other_conditions_are_refused_unless_they_are_what_is_compared(other: dict):
    a = results([1.0, 1.0])
    b = results([0.0, 1.0], folder="b", **other)
    ((name, value),) = other.items()
    if name == "salt":
        value = split_digits(value)
    told = ", ".join(value) if isinstance(value, tuple) else value
    with pytest.raises(ValueError, match=f"b has {name} '{told}'"):
        compare(a, b, "S_loc", across=[crossed for crossed in CROSSABLE if crossed != name])
    if name in CROSSABLE or name == "benchmark":
        allowed = compare(a, b, "S_loc", across=CROSSABLE, allow_version_mismatch=True)
        assert allowed.value == pytest.approx(0.5)
