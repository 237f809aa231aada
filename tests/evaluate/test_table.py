"""The printed tables: what stands in them, in which unit, and how it lines up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from dynahoi_lerobot.evaluate.results import Results, RunInfo
from dynahoi_lerobot.evaluate.rows import episode_row
from dynahoi_lerobot.evaluate.summary import Estimate
from dynahoi_lerobot.evaluate.table import MAIN_COLUMNS, heading, metric_cell, results_table
from tests.synthetic import synthetic_episode


def results(policy: str = "reach", capture: str = "attach") -> Results:
    rows = []
    for seed in range(4):
        episode = synthetic_episode(seed, image_size=None, miss_m=0.05 * (seed == 0))
        meta = replace(episode.meta, capture=capture, motion=("constant", "lob")[seed % 2])
        rows.append(episode_row(replace(episode, meta=meta)))
    return Results(Path("run"), RunInfo(policy, "test", capture, "cmd", "f"), tuple(rows), ())


def printed(*estimate: object) -> tuple[str, str]:
    cell = metric_cell(Estimate(*estimate))
    return cell.text, cell.detail


def test_numbers_are_printed_in_the_papers_units():
    assert printed(0.279, 0.25, 0.3, "fraction", 9) == ("27.9", "[25.0, 30.0]")
    assert printed(0.846, 0.5, 1.0, "u", 9) == ("0.85", "[0.50, 1.00]")
    assert printed(-0.05, -0.1, 0.0, "score", 9) == ("-0.05", "[-0.10, 0.00]")
    assert printed(None, None, None, "score", 0) == ("-", "")
    assert [heading(name) for name in ("S_loc", "E_loc", "Q_line")] == ["S_loc % ↑", "E_loc u ↓", "Q_line ↑"]


def test_one_line_per_evaluation_under_what_they_share():
    shared, header, rule, *lines = results_table([results("a"), results("a much longer name")]).split("\n")
    assert "split test" in shared
    assert "n 4" in shared
    assert "split" not in header
    assert all(f" {name} " in header for name in MAIN_COLUMNS)
    assert set(rule) == {"-"}
    assert [line.split()[0] for line in lines] == ["a", "a"]
    assert len({line.index("75.0 [") for line in lines}) == 1, "columns must line up"
    assert len(header) == len(rule) == len(lines[0])


def test_the_contact_rule_leads_with_holding():
    shared, header, *_ = results_table([results(), results(capture="contact")]).split("\n")
    assert header.index("capture") < header.index("S_hold") < header.index("S_loc")
    assert "capture" not in shared
    assert "S_hold" not in results_table([results()])
