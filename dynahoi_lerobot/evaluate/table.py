"""Results as plain-text tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.evaluate.summary import Estimate, Summary, summarise_by
from dynahoi_lerobot.metrics import METRICS

MAIN_COLUMNS = ("S_loc", "S_joint", "S_gra_two_sided", "S_gra", "E_loc", "E_gra", "Q_smooth", "Q_line", "R_time")
"""The paper's seven metrics, and beside its S_gra, which a fist passes, the grasp that a fist fails."""

LABELS = ("policy", "split", "protocol", "capture", "control", "inference", "benchmark")
"""Titles of what is said about an evaluation in front of its numbers."""


def results_table(results: Sequence[Results], columns: Sequence[str] | None = None) -> str:
    """Return one row per evaluation: what was run, number of episodes, and each metric with its interval."""
    columns = columns or columns_for(results)
    rows = [[*labels(result), str(len(result.rows)), *_cells(result.summary(), columns)] for result in results]
    return _aligned([[*LABELS, "n", *map(heading, columns)], *rows], left=len(LABELS))


def stratum_table(results: Results, stratum: str = "kind", columns: Sequence[str] | None = None) -> str:
    """Return one row per label of ``stratum``, ``kind`` by default, each metric with its interval."""
    columns = columns or columns_for([results])
    groups: Mapping[str, Summary] = summarise_by(results.rows, stratum)
    counts = {label: sum(row[stratum] == label for row in results.rows) for label in groups}
    rows = [[label, str(counts[label]), *_cells(summary, columns)] for label, summary in groups.items()]
    return _aligned([[stratum, "n", *map(heading, columns)], *rows], left=1)


def columns_for(results: Sequence[Results]) -> tuple[str, ...]:
    """Return the main columns, led by S_hold if any evaluation uses the capture rule contact."""
    return ("S_hold",) * any(r.info.capture == "contact" for r in results) + MAIN_COLUMNS


def heading(name: str) -> str:
    """Return a metric's column title: its name, its printed unit, and an arrow towards better."""
    metric = METRICS[name]
    unit = {"fraction": " %", "score": ""}.get(metric.unit, f" {metric.unit}")
    return f"{name}{unit} {'↑' if metric.direction == 'higher' else '↓'}"


def printed(estimate: Estimate) -> str:
    """Return ``value [low, high]``, fractions in per cent; a dash where no episode meets the condition."""
    return " ".join(part for part in printed_parts(estimate) if part)


def printed_parts(estimate: Estimate) -> tuple[str, str]:
    """Return the value and its interval as ``printed`` joins them."""
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return "-", ""
    scale, digits = (100, 1) if estimate.unit == "fraction" else (1, 2)
    value, *ends = (f"{scale * end:.{digits}f}" for end in (estimate.value, estimate.low, estimate.high))
    return value, f"[{', '.join(ends)}]"


def labels(result: Results) -> list[str]:
    """Return what ``LABELS`` says about an evaluation: under other conditions its numbers do not compare."""
    info = result.info
    played = [info.split, result.protocol, info.capture, result.control_class, result.inference]
    return [result.shown_policy, *played, info.benchmark]


def _cells(summary: Summary, columns: Sequence[str]) -> list[str]:
    return [printed(summary[name]) for name in columns]


def _aligned(table: list[list[str]], left: int) -> str:
    """Return the lines of ``table``, its first ``left`` columns flush left and the others flush right."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if place < left else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in table
    ]
    return "\n".join([lines[0], "-" * max(map(len, lines)), *lines[1:]])
