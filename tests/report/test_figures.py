"""Every registered figure draws real and odd data, or says that there is nothing to draw."""

from __future__ import annotations

import base64
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import HAND_DOF
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.evaluate.episode_row import episode_row
from dynahoi_lerobot.evaluate.summary import Estimate
from dynahoi_lerobot.report.entries import Entry, read_entries
from dynahoi_lerobot.report.figures.base import FIGURES, in_order, scaled
from dynahoi_lerobot.report.figures.curves import condition, declared_ms, grouped, policy_and_rules
from dynahoi_lerobot.report.figures.episodes import by_object, command_deltas, overlay
from dynahoi_lerobot.report.style import new_figure
from tests.report.example_runs import example_run

HOSTILE = '<script>$x^{"&$'
ALWAYS = {"main", "stages", "per-frame-grasp", "data", "grasp-magnitude", "joint-deltas", "palm-displacements"}


def runs(root: Path) -> list[Entry]:
    example_run(root / "a", HOSTILE, 0.9, 24, n_obs_frames=5, data_fraction=1.0)
    example_run(
        root / "b", "contact", 0.4, 12, capture="contact", n_obs_frames=1, data_fraction=0.5, inference="rtc 150 ms"
    )
    return read_entries([root / "a", root / "b"])


@pytest.fixture(scope="module")
def entries(tmp_path_factory: pytest.TempPathFactory) -> list[Entry]:
    return runs(tmp_path_factory.mktemp("runs"))


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


@pytest.mark.parametrize("name", FIGURES.names())
def test_a_figure_is_a_well_formed_inert_drawing(name: str, entries: list[Entry]):
    address = FIGURES[name].render(entries)
    assert address is not None
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


@pytest.mark.parametrize("name", FIGURES.names())
def test_a_figure_of_one_episode_is_drawn_or_left_out(name: str, lone: list[Entry]):
    address = FIGURES[name].render(lone)
    assert (address is not None) == (name in ALWAYS)


def test_a_curve_needs_two_numbers(tmp_path: Path):
    example_run(tmp_path / "a", "a", 0.9, 2, n_obs_frames=5)
    example_run(tmp_path / "b", "b", 0.4, 2, n_obs_frames=5, data_fraction="half")
    entries = read_entries([tmp_path / "a", tmp_path / "b"])
    assert FIGURES["obs-frames"].render(entries) is None
    assert FIGURES["data-scaling"].render(entries) is None


def test_a_study_has_a_curve_for_each_condition(tmp_path: Path):
    for name, which, s in (("a", "late", 0), ("b", "late", 5), ("c", "replanning", 5), ("d", "replanning", 0)):
        example_run(tmp_path / name, name, 0.5, 2, n_obs_frames=s, condition=which)
    drawn = grouped(read_entries([tmp_path / name for name in "abcd"]), condition)
    assert {curve.label: {entry.results.folder.name for entry in curve.entries} for curve in drawn} == {
        "late": {"a", "b"},
        "replanning": {"c", "d"},
    }
    assert len({curve.colour for curve in drawn}) == 2


def test_a_study_of_several_seeds_has_a_curve_for_each(tmp_path: Path):
    for name, seed, s in (("a", 1, 0), ("b", 1, 5), ("c", 2, 5), ("d", 2, 0)):
        example_run(tmp_path / name, name, 0.5, 2, n_obs_frames=s, condition="late", training_seed=seed)
    drawn = grouped(read_entries([tmp_path / name for name in "abcd"]), condition)
    assert {curve.label: {entry.results.folder.name for entry in curve.entries} for curve in drawn} == {
        "seed 1": {"a", "b"},
        "seed 2": {"c", "d"},
    }


def test_latency_has_a_line_for_each_policy_and_way_of_bridging_it(tmp_path: Path):
    timings = {"a": "", "b": "async 150 ms", "c": "async 150 ms, corrected", "d": "async measured", "e": "soon"}
    for name, inference in timings.items():
        example_run(tmp_path / name, "tracker", 0.5, 2, inference=inference)
    entries = read_entries([tmp_path / name for name in timings])
    assert FIGURES["latency"].render(entries) is not None
    lines = grouped(entries, policy_and_rules)
    assert {curve.label: {entry.results.folder.name for entry in curve.entries} for curve in lines} == {
        "tracker": {"a", "b", "d", "e"},
        "corrected": {"c"},
    }
    known = {entry.results.folder.name: declared_ms(entry) for entry in entries}
    assert known == {"a": 0.0, "b": 150.0, "c": 150.0, "d": None, "e": None}
    assert FIGURES["latency"].render(read_entries([tmp_path / "a", tmp_path / "d"])) is None, "one number is no line"


def test_commands_that_never_change_still_have_a_histogram(lone: list[Entry]):
    _, (panel,) = new_figure(1, 1, 2.0)
    overlay(panel, [np.zeros(5)], lone)
    values, edges, _ = panel.patches[0].get_data()
    assert edges[0] < 0 < edges[-1]
    assert values.max() == 100


def test_the_same_results_give_the_same_drawing(entries: list[Entry]):
    assert FIGURES["main"].render(entries) == FIGURES["main"].render(entries)


def test_labels_are_shown_literally(entries: list[Entry]):
    texts = [element.text for element in ElementTree.fromstring(svg(FIGURES["stages"].render(entries))).iter()]
    assert any(text and text.strip() == entries[0].label for text in texts)


def test_figures_have_an_order_and_say_what_they_show():
    places = [figure.place for figure in in_order()]
    assert places == sorted(places)
    assert len(set(places)) == len(places)
    for figure in in_order():
        assert figure.caption.endswith(".")
        assert len(figure.caption) > 40


def test_an_empty_group_before_others_does_not_change_their_scale():
    missing, half = Estimate(None, None, None, "score", 0), Estimate(0.5, 0.25, 0.75, "fraction", 4)
    values, reach = scaled([missing, half])
    np.testing.assert_array_equal(values, [np.nan, 50.0])
    np.testing.assert_array_equal(reach[:, 1], [25.0, 25.0])


def test_intervals_are_scaled_as_they_are_printed(entries: list[Entry]):
    estimate = entries[0].summary["S_loc"]
    values, reach = scaled([estimate])
    assert values[0] == pytest.approx(100 * estimate.value)
    assert reach[:, 0] == pytest.approx([100 * (estimate.value - estimate.low), 100 * (estimate.high - estimate.value)])


def test_deltas_are_those_of_the_control_phase(entries: list[Entry]):
    results = entries[0].results
    deltas = command_deltas(results)
    expected = sum(
        len(actions) - row["window_frames"] - 1 for row, actions in zip(results.rows, results.actions, strict=True)
    )
    assert deltas.shape == (expected, HAND_DOF)
    first = results.actions[0][results.rows[0]["window_frames"] :]
    assert deltas[0].tolist() == (first[1] - first[0]).tolist()


def test_small_objects_need_large_grasps_and_are_caught_from_near_and_far(
    specs: list[EpisodeSpec], expert_episodes: list[Episode]
):
    rows = [episode_row(episode) for episode in expert_episodes]
    radius_m = np.array([spec.target.grasp_radius_m for spec in specs])
    grasp_rad = np.array([row["grasp_rad"] for row in rows])
    assert np.corrcoef(radius_m, grasp_rad)[0, 1] < -0.9
    objects = by_object(rows)
    assert sum(map(len, objects.values())) == len(rows)
    means = [points[:, 1].mean() for points in objects.values()]
    assert means == sorted(means, reverse=True)
    for name, points in objects.items():
        wanted = sorted(row["travel_u"] for row in rows if row["object"] == name)
        assert sorted(points[:, 0]) == wanted
