"""Measured figures in the pages are those of docs/figures, which say where they come from and are
of today.
"""

import json
import re
from pathlib import Path

import pytest
import tables
from support.options import pinned_benchmark

TODAY = {"command": "measure", "commit": "abc", "processor": "P", "benchmark": pinned_benchmark()}
FOLDERS = sorted(tables.FIGURES.glob("*.json"))


@pytest.mark.parametrize(
    "path", tables.PAGES, ids=lambda path: path.relative_to(tables.REPOSITORY).as_posix()
)
def test_pages_show_the_figures_on_file(path: Path):
    page = path.read_text()
    assert page == tables.rendered(page), "run python benchmarks/tables.py"


@pytest.mark.parametrize("path", FOLDERS, ids=lambda path: path.stem)
def test_figures_say_what_was_run_and_are_of_today(path: Path):
    content = json.loads(path.read_text())
    assert not list(tables.unexplained(content, path.name))
    old = [part["command"] for part in tables.outdated(content)]
    assert not old, (
        "measure again, or say what they are of: python benchmarks/tables.py --stale SENTENCE"
    )


def test_every_block_is_shown_and_the_readme_states_no_interval_of_its_own():
    shown = {name for path in tables.PAGES for _, name, _ in tables.BLOCK.findall(path.read_text())}
    assert shown == set(re.findall(r"block (\w+)", (tables.FIGURES / "tables.jinja").read_text()))
    assert not re.findall(
        r"\[\d+\.\d, \d+\.\d\]", tables.BLOCK.sub("", tables.PAGES[0].read_text())
    )


def test_a_stale_figure_bears_a_mark_and_its_footnote(tmp_path: Path):
    (tmp_path / "tables.jinja").write_text(
        "{% block one %}\n| {{ f.rows.a | show }} | {{ f.rows.b | brief(0) }} |\n{% endblock %}"
    )
    rows = {
        "a": {"value": 1.25, "low": 1, "high": 2},
        "b": {"stale": "Of v1.", "value": 0.25, "unit": "fraction"},
    }
    page = "A\n<!-- figures: one -->\n| 7 |\n<!-- end of figures -->\nB"
    (tmp_path / "f.json").write_text(json.dumps({"rows": rows}))
    found = tables.rendered(page, tmp_path)
    assert "| 1.2 [1.0, 2.0] | 25† |\n\n† Of v1.\n" in found
    assert tables.rendered(found, tmp_path) == found


def test_figures_of_another_benchmark_of_other_weights_and_without_provenance_are_found():
    old = {"benchmark": {"version": "v0", "digest": "0"}}
    other = {"checkpoint": "obact_standard", "weights": {"model.safetensors": "0"}}
    for change, expected in (({}, 0), (old, 1), (old | {"stale": "Of v0."}, 0), (other, 1)):
        assert (
            len(list(tables.outdated({"rows": {"a": TODAY | change | {"x": {"value": 1}}}})))
            == expected
        )
    rows = {"a": {"value": 1}, "b": TODAY | {"value": 1}}
    assert list(tables.unexplained({"rows": rows}, "f")) == ["f/rows/a/value"]
