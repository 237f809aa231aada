"""Of every episode a row, of the rows groups and intervals, of those the printed tables."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.evaluate import summary
from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.evaluate.rows import episode_row
from dynahoi_lerobot.evaluate.summary import Estimate, bootstrap, wilson
from dynahoi_lerobot.evaluate.table import (
    MAIN_COLUMNS,
    columns_for,
    metric_cell,
    metrics_table,
    results_table,
)
from dynahoi_lerobot.metrics.columns import STRATA
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.base import CATEGORIES
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from tests.evaluate.test_compare import results as scored
from tests.synthetic import run_info, synthetic_episode

EPISODE = synthetic_episode(image_size=None)


def label(stratum: str, **meta: object) -> str:
    return STRATA[stratum].label(changed(EPISODE, meta))


@pytest.mark.parametrize("name", ["tier", "periodicity", "category"])
def test_every_category_has_its_place_and_those_of_others_have_one_of_their_own(name: str):
    assert {label(name, category=category) for category in CATEGORIES} <= {*STRATA[name].order} - {
        "other"
    }
    assert label(name, category="somebody_elses") == (
        "somebody_elses" if name == "category" else "other"
    )
    example = {"tier": "physical", "periodicity": "periodic", "category": "pendulum"}
    assert label(name, category="pendulum") == example[name]


def test_bins_of_duration_and_of_travel_from_the_palm_at_control_start_to_the_intercept():
    frames = {
        19: "<20",
        20: "20-40",
        40: "20-40",
        41: "40-60",
        60: "40-60",
        80: "60-80",
        120: "80-120",
        121: ">120",
    }
    assert {n: label("duration", length_frames=n) for n in frames} == frames
    window = EPISODE.meta.window_frames
    state = EPISODE.state.copy()
    start = state[window, :3]
    state[:window, :3] = 50.0
    for distance_m, expected in {0.04: "0-0.5", 0.06: "0.5-2", 0.21: "2-4", 0.41: ">4"}.items():
        goal = start + np.array([0, distance_m, 0], np.float32)
        travelled = replace(EPISODE, state=state, intercept_pos_h=goal)
        assert STRATA["travel"].label(travelled) == expected
    assert STRATA["duration"].arrange({">120", "20-40", "odd", "80-120"}) == [
        "20-40",
        "80-120",
        ">120",
        "odd",
    ]


@pytest.mark.parametrize("count", [1, 7, 110, 263])
def test_wilson_is_scipys_and_touches_0_and_1_exactly(count: int):
    for successes in range(count + 1):
        wanted = binomtest(successes, count).proportion_ci(method="wilson")
        assert wilson(successes, count) == pytest.approx(tuple(wanted))
    assert (wilson(0, count)[0], wilson(count, count)[1]) == (0.0, 1.0)


def test_bootstrap_is_deterministic_blind_to_order_and_draws_from_all_values():
    values = np.random.default_rng(0).normal(size=50)
    assert bootstrap(values) == bootstrap(values[::-1].copy())
    assert bootstrap(np.array([0.0, 1.0])) == (0.0, 1.0)


@pytest.mark.parametrize("resamples_at_once", [1, 7])
def test_bootstrap_in_pieces_gives_the_same_interval(resamples_at_once: int, monkeypatch):
    """Pieces bound its memory; 7 does not divide the number of resamples."""
    values = np.random.default_rng(0).normal(size=51)
    whole = bootstrap(values)
    monkeypatch.setattr(summary, "RESAMPLED_AT_ONCE", resamples_at_once * len(values))
    assert bootstrap(values) == whole


def test_bootstrap_covers_the_true_mean_about_95_times_of_100():
    rng = np.random.default_rng(2)
    samples = (rng.exponential(1.0, 60) for _ in range(200))
    hits = sum(low <= 1.0 <= high for low, high in map(bootstrap, samples))
    assert 0.88 <= hits / 200 <= 0.98


def results(policy: str = "reach", capture: str = "attach", **recipe: Any) -> Results:
    rows = []
    for seed in range(4):
        episode = synthetic_episode(seed, image_size=None, miss_m=0.05 * (seed == 0))
        meta = {"capture": capture, "motion": ("constant", "lob")[seed % 2]}
        rows.append(episode_row(changed(episode, meta)))
    return Results(Path("run"), run_info(policy, capture=capture, **recipe), tuple(rows), ())


def test_numbers_are_printed_in_the_papers_units():
    for estimate, text in (
        ((0.279, "fraction"), "27.9"),
        ((0.846, "u"), "0.85"),
        ((None, "score"), ""),
        ((-0.0002, "fraction"), "0.0"),
    ):
        value, unit = estimate
        assert metric_cell(Estimate(value, value, value, unit, 9)).text == text


def test_many_evaluations_are_lines_and_few_are_columns_under_what_they_share():
    shared, header, rule, *lines = results_table(
        [results("a"), *[results("a much longer name")] * 3]
    ).split("\n")
    assert "split test" in shared
    assert all(f" {name} " in header for name in MAIN_COLUMNS)
    assert [line.split()[0] for line in lines] == ["a"] * 4
    assert {len(line) for line in lines} == {len(header)} == {len(rule)}, "columns must line up"
    _, header, rule, *lines = results_table([results("a"), results("b"), results("c")]).split("\n")
    assert header.split() == ["policy", "a", "b", "c"]
    assert [line.split()[0] for line in lines] == list(MAIN_COLUMNS)
    assert all(len(line) == len(rule) <= 100 for line in lines)


def test_other_motions_are_other_conditions_however_many_they_are():
    many = [name for name in MOTIONS.names() if name in BENCHMARK.splits["test"].motions]
    played = [results(motions=tuple(many[first : first + 5])) for first in (0, 1)]
    table = metrics_table(["a", "b"], played, ["S_loc"])
    told = [row[table.head.index("motions")].text for row in table.rows]
    assert len(set(told)) == 2
    assert all(re.fullmatch(r"5 \(set [0-9a-f]{8}\)", text) for text in told)
    assert f"motions {told[0]}" in metrics_table(["a", "b"], [played[0]] * 2, ["S_loc"]).caption


def test_a_name_with_line_ends_adds_no_line_to_a_table():
    plain = results_table([results("a"), results("b")])
    odd = results_table([results("a\nS_loc % ↑  100.0"), results("b")])
    assert odd.count("\n") == plain.count("\n")


def test_motions_and_objects_are_named_where_some_are_left_out():
    some = {"motions": ("lob", "bounce"), "objects": ("ball",)}
    many = {"motions": ("lob", "bounce", "constant", "lateral")}
    everything = results()
    restricted = results(**some)
    assert "motions" not in results_table([everything])
    assert "motions lob, bounce, objects ball" in results_table([restricted])
    _, *lines = results_table([everything, restricted, results(**many)]).split("\n")
    rows = [" ".join(line.split()) for line in lines]
    assert {"motions all lob, bounce 4 (set c95b40e0)", "objects all ball all"} <= {*rows}


def test_the_contact_rule_leads_with_holding():
    _, _, _, *lines = results_table([results(), results(capture="contact")]).split("\n")
    first = [line.split()[0] for line in lines]
    assert first[:4] == ["capture", "hand", "S_hold", "S_loc"]
    assert "S_hold" not in results_table([results()])


def test_a_metric_that_does_not_apply_is_an_empty_cell_or_no_column():
    attach = results()
    contact = results(capture="contact")
    assert contact.summary["S_joint"] == Estimate(None, None, None, "fraction", 0)
    assert columns_for([contact]) == ("S_hold", "S_loc", "E_loc", "E_gra", *MAIN_COLUMNS[-3:])
    table = metrics_table(["a", "c"], [attach, contact], columns_for([attach, contact]))
    place = next(i for i, head in enumerate(table.head) if head.startswith("S_joint"))
    assert [row[place].text for row in table.rows] == ["75.0", ""]
    assert table.rows[1][place].key is None


def bold(*values: list[float], metric: str = "S_loc", apart: int = 0) -> list[bool]:
    """Which of some evaluations are bold, given the values of each; the seeds of each begin so far
    ``apart``.
    """
    found = [scored(one, metric, first_seed=apart * i) for i, one in enumerate(values)]
    labels = [str(i) for i in range(len(found))]
    return [row[-1].mark == "best" for row in metrics_table(labels, found, [metric]).rows]


def test_bold_is_what_a_paired_test_of_enough_episodes_supports():
    good = [1.0] * 40
    fair = [1.0] * 38 + [0.0] * 2
    bad = [1.0, 0.0] * 20
    assert bold(good, bad) == [True, False]
    assert bold(bad, good) == [False, True]
    assert bold(good, fair) == [False, False], "2 of 40 may be chance"
    assert bold(good, fair, bad) == [False] * 3, "not the second, too"
    assert bold(good) == [False]
    ten = [1.0] * 10
    assert bold(ten, [0.0] * 10) == [False, False]
    assert bold(ten, fair, bad) == [False, True, False], (
        "ten episodes neither win nor stand in the way"
    )
    assert bold(good, bad, apart=100) == [False, False], "no episode in common"
    assert bold(good, [0.5] * 40, metric="E_loc") == [False, True], "nearer"
