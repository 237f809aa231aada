"""Every figure draws real and odd data, or says that there is nothing to draw."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.evaluate.rows import episode_row
from dynahoi_lerobot.evaluate.summary import Estimate
from dynahoi_lerobot.report import figures
from dynahoi_lerobot.report.entries import Entry, read_entries
from dynahoi_lerobot.report.figures import by_object, command_deltas, condition, grouped, latency_ms, policy_and_rules
from tests.report.example_runs import example_run

HOSTILE = '<script>$x^{"&$'
FIGURES = {figure.name: figure for figure in figures.FIGURES}
ALWAYS = {"main", "stages", "per-frame-grasp", "data", "grasp-magnitude", "joint-deltas", "palm-displacements"}


@pytest.fixture(scope="module")
def entries(tmp_path_factory: pytest.TempPathFactory) -> list[Entry]:
    root = tmp_path_factory.mktemp("runs")
    example_run(root / "a", HOSTILE, 0.9, 24, n_obs_frames=5, data_fraction=1.0)
    contact = {"n_obs_frames": 1, "data_fraction": 0.5, "inference": "rtc 150 ms"}
    example_run(root / "b", "contact", 0.4, 12, capture="contact", **contact)
    return read_entries([root / "a", root / "b"])


@pytest.fixture(scope="module")
def lone(tmp_path_factory: pytest.TempPathFactory) -> list[Entry]:
    """One evaluation of one episode: the least there can be."""
    root = tmp_path_factory.mktemp("lone")
    example_run(root, "lone", 0.0, 1)
    return read_entries([root])


def svg(address: str) -> str:
    head, _, data = address.partition(",")
    assert head == "data:image/svg+xml;base64"
    return base64.b64decode(data).decode()


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_a_well_formed_inert_drawing(name: str, entries: list[Entry]):
    address = FIGURES[name].render(entries)
    assert address is not None
    assert len(FIGURES[name].caption) > 40
    text = svg(address)
    root = ElementTree.fromstring(text)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    tags = {element.tag.partition("}")[2] for element in root.iter()}
    assert {"path", "text"} <= tags
    assert not tags & {"script", "foreignObject"}
    links = [value for element in root.iter() for key, value in element.attrib.items() if key.endswith("href")]
    assert all(link.startswith(("#", "data:")) for link in links)
    assert "mathdefault" not in text
    assert "nan" not in "".join(element.get("d", "") for element in root.iter())
    assert "prefers-color-scheme" in text
    assert "var(--ink)" in text
    if name == "stages":
        assert any((element.text or "").strip() == entries[0].label for element in root.iter())
        assert address == FIGURES[name].render(entries), "the same results give the same drawing"


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_of_one_episode_is_drawn_or_left_out(name: str, lone: list[Entry]):
    assert (FIGURES[name].render(lone) is not None) == (name in ALWAYS)


def test_a_curve_needs_two_numbers(tmp_path: Path):
    example_run(tmp_path / "a", "a", 0.9, 2, n_obs_frames=5)
    example_run(tmp_path / "b", "b", 0.4, 2, n_obs_frames=5, data_fraction="half", inference="async measured")
    entries = read_entries([tmp_path / "a", tmp_path / "b"])
    assert not any(FIGURES[name].render(entries) for name in ("obs-frames", "data-scaling", "latency"))


def lines(tmp_path: Path, runs: dict[str, dict], group: Callable[[Entry], tuple[str, ...]]) -> dict[str, str]:
    """Return the names of the runs on each line."""
    for name, extra in runs.items():
        example_run(tmp_path / name, "obact", 0.5, 2, **extra)
    drawn = grouped(read_entries([tmp_path / name for name in runs]), group)
    assert len({curve.colour for curve in drawn}) == len(drawn)
    return {curve.label: "".join(sorted(entry.results.folder.name for entry in curve.entries)) for curve in drawn}


def test_a_study_has_a_curve_for_each_condition_or_training_seed(tmp_path: Path):
    runs = {"a": {"condition": "late"}, "b": {"condition": "late"}, "c": {"condition": "replanning"}}
    assert lines(tmp_path, runs, condition) == {"late": "ab", "replanning": "c"}
    runs = {name: {"condition": "late", "training_seed": seed} for name, seed in (("d", 1), ("e", 2), ("f", 2))}
    assert lines(tmp_path, runs, condition) == {"seed 1": "d", "seed 2": "ef"}


def test_latency_has_a_line_for_each_policy(tmp_path: Path):
    timings = {"a": "", "b": "async 150 ms", "c": "rtc 370 ms", "d": "async measured", "e": "soon"}
    runs = {name: {"inference": inference} for name, inference in timings.items()}
    assert lines(tmp_path, runs, policy_and_rules) == {"obact": "abcde"}
    entries = read_entries([tmp_path / name for name in timings])
    known = {entry.results.folder.name: latency_ms(entry) for entry in entries}
    assert known == {"a": 0.0, "b": 150.0, "c": 370.0, "d": None, "e": None}


def test_commands_that_never_change_still_have_a_histogram(lone: list[Entry]):
    _, (panel,) = figures.subplots(1, 1, 2.0)
    figures.overlay(panel, [np.zeros(5)], lone)
    values, edges, _ = panel.patches[0].get_data()
    assert edges[0] < 0 < edges[-1]
    assert values.max() == 100


def test_values_and_intervals_are_drawn_as_they_are_printed():
    half = Estimate(0.5, 0.25, 0.75, "fraction", 4)
    for missing in (None, Estimate(None, None, None, "score", 0)):
        values, reach = figures.printed([missing, half])
        np.testing.assert_array_equal(values, [np.nan, 50.0])
        np.testing.assert_array_equal(reach[:, 1], [25.0, 25.0])


def test_deltas_are_those_of_the_control_phase(entries: list[Entry]):
    results = entries[0].results
    logs = [actions[row["window_frames"] :] for row, actions in zip(results.rows, results.actions, strict=True)]
    deltas = command_deltas(results)
    assert deltas.shape == (sum(len(log) - 1 for log in logs), 18)
    assert deltas[0].tolist() == (logs[0][1] - logs[0][0]).tolist()


def test_small_objects_need_large_grasps_and_are_caught_from_near_and_far(
    specs: list[EpisodeSpec], expert_episodes: list[Episode]
):
    rows = [episode_row(episode) for episode in expert_episodes]
    radius_m = np.array([spec.target.grasp_radius_m for spec in specs])
    assert np.corrcoef(radius_m, [row["grasp_rad"] for row in rows])[0, 1] < -0.9
    objects = by_object(rows)
    assert sum(map(len, objects.values())) == len(rows)
    means = [points[:, 1].mean() for points in objects.values()]
    assert means == sorted(means, reverse=True)
    for name, points in objects.items():
        assert sorted(points[:, 0]) == sorted(row["travel_u"] for row in rows if row["object"] == name)
