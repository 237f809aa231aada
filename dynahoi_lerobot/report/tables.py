"""The report's tables as data for the template: cells with a text, a sort key and a CSS class."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial

from dynahoi_lerobot.evaluate.compare import (
    Comparison,
    command_distances_cm,
    compare,
    paired_values,
    unequal_conditions,
)
from dynahoi_lerobot.evaluate.intervals import bootstrap
from dynahoi_lerobot.evaluate.summary import Estimate, Summary
from dynahoi_lerobot.evaluate.table import LABELS, columns_for, heading, labels, printed_parts
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.report.entries import Entry

COMPARED = ("S_hold", "S_loc", "S_joint", "E_loc")
"""Metrics of the paired comparisons; those without pairs are omitted."""

COMMANDS = "Mean distance of the palm positions that they commanded in the same frames [cm]."

SIGNIFICANT = 0.05


@dataclass(frozen=True)
class Cell:
    """One cell.

    Attributes:
        text: what is printed.
        detail: a smaller line under it.
        key: the number to sort by; None sorts by the text.
        mark: CSS class.
    """

    text: str
    detail: str = ""
    key: float | None = None
    mark: str = ""


@dataclass(frozen=True)
class Table:
    """A table: a caption, its column titles and its rows."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def main_metrics(entries: Sequence[Entry]) -> Table:
    """Return the main columns of each evaluation; the best of equals is marked."""
    names = columns_for([entry.results for entry in entries])
    return _metric_table("One row per evaluation, 95 % intervals under the values.", entries, names)


def other_metrics(entries: Sequence[Entry]) -> Table:
    """Return every other registered metric, one row per evaluation."""
    shown = columns_for([entry.results for entry in entries])
    names = [name for name in METRICS.names() if name not in shown]
    return _metric_table("All other metrics, one row per evaluation.", entries, names)


def stratum_tables(entries: Sequence[Entry], stratum: str) -> list[Table]:
    """Return one table per evaluation with a row for each label of ``stratum``."""
    return [_stratum_table(entry, stratum) for entry in entries]


def glossary() -> Table:
    """Return the definition of every registered metric: unit, direction, condition, formula and source."""
    arrows = {"higher": "↑ higher", "lower": "↓ lower"}
    rows = tuple(
        (
            Cell(name),
            Cell(metric.unit),
            Cell(arrows[metric.direction]),
            Cell(metric.condition or "all"),
            Cell(metric.doc),
        )
        for name, metric in METRICS.items()
    )
    return Table("Definitions of all metrics.", ("metric", "unit", "better", "episodes", "definition"), rows)


def comparison_tables(entries: Sequence[Entry], across: Collection[str] = ()) -> list[Table]:
    """Return a matrix for each compared metric: row minus column on the episodes both played; none without pairs.

    Only evaluations under equal conditions are paired, except for those that are compared, ``across``.
    """
    cells = {f"{heading(name)}: row minus column.": partial(_compared, name=name) for name in COMPARED}
    cells[COMMANDS] = _commands_apart
    tables = [_matrix(entries, caption, cell, across) for caption, cell in cells.items()]
    return [table for table in tables if table is not None]


def _metric_table(caption: str, entries: Sequence[Entry], names: Sequence[str]) -> Table:
    """Return a row for each evaluation.

    Conditions that all evaluations share are in the caption, so that the metrics fit the page.
    """
    best = _best(entries, names)
    conditions = [(*labels(entry.results)[1:], str(len(entry.results.rows))) for entry in entries]
    titles = (*LABELS[1:], "n")
    differing = [i for i, values in enumerate(zip(*conditions, strict=True)) if len(set(values)) > 1]
    shared = [f"{title} {conditions[0][i]}" for i, title in enumerate(titles) if i not in differing]
    rows = tuple(
        (
            Cell(entry.label), *(_condition(titles[i], conditions[place][i]) for i in differing),
            *(_cell(entry.summary[name], "best" if (place, name) in best else "") for name in names),
        )
        for place, entry in enumerate(entries)
    )  # fmt: skip
    caption = f"{caption} All of them: {', '.join(shared)}." if shared else caption
    return Table(caption, (LABELS[0], *(titles[i] for i in differing), *map(heading, names)), rows)


def _best(entries: Sequence[Entry], names: Sequence[str]) -> set[tuple[int, str]]:
    """Return (row, metric) of the best values among rows under equal conditions, if there are two at least."""
    groups: dict[tuple[str, ...], list[int]] = defaultdict(list)
    for place, entry in enumerate(entries):
        groups[tuple(labels(entry.results)[1:])].append(place)
    return {
        (place, name)
        for places in groups.values()
        for name in names
        for place in _winners({place: entries[place].summary[name].value for place in places}, name)
    }


def _winners(values: dict[int, float | None], name: str) -> list[int]:
    known = {place: value for place, value in values.items() if value is not None}
    if len(known) < 2:
        return []
    top = max(known.values()) if METRICS[name].direction == "higher" else min(known.values())
    return [place for place, value in known.items() if value == top]


def _stratum_table(entry: Entry, stratum: str) -> Table:
    names = columns_for([entry.results])
    rows = tuple(
        (Cell(label), _count(sum(row[stratum] == label for row in entry.results.rows)), *_cells(summary, names))
        for label, summary in entry.by(stratum).items()
    )
    return Table(entry.label, (stratum, "n", *map(heading, names)), rows)


def _matrix(
    entries: Sequence[Entry], caption: str, compared: Callable[[Entry, Entry], Cell], across: Collection[str]
) -> Table | None:
    def cell(row: Entry, column: Entry) -> Cell:
        if unequal := unequal_conditions(row.results, column.results, across):
            return Cell("–", f"other {' and '.join(unequal)}")
        return Cell("–") if row is column else compared(row, column)

    cells = [[cell(row, column) for column in entries] for row in entries]
    if not any(cell.key is not None for line in cells for cell in line):
        return None
    rows = tuple((Cell(entry.label), *line) for entry, line in zip(entries, cells, strict=True))
    return Table(caption, ("row, column", *(entry.label for entry in entries)), rows)


def _commands_apart(row: Entry, column: Entry) -> Cell:
    apart = command_distances_cm(row.results, column.results)
    if len(apart) == 0:
        return Cell("–")
    mean, (low, high) = float(apart.mean()), bootstrap(apart)
    return Cell(f"{mean:.2f}", f"[{low:.2f}, {high:.2f}] n = {len(apart)}", mean)


def _compared(row: Entry, column: Entry, name: str) -> Cell:
    if len(paired_values(row.results.rows, column.results.rows, name)) == 0:
        return Cell("–")
    result = compare(row.results.rows, column.results.rows, name, allow_version_mismatch=True)  # or read_entries refused
    estimate = Estimate(result.difference, result.low, result.high, METRICS[name].unit, result.n)
    difference, ends = printed_parts(estimate)
    p_value = "p < 0.001" if result.p_value < 0.001 else f"p = {result.p_value:.3f}"
    return Cell(difference, f"{ends} {p_value}, n = {result.n}", result.difference, _verdict(result))


def _verdict(result: Comparison) -> str:
    if result.p_value >= SIGNIFICANT or result.difference == 0:
        return ""
    return "better" if (result.difference > 0) == (METRICS[result.metric].direction == "higher") else "worse"


def _cells(summary: Summary, names: Sequence[str]) -> list[Cell]:
    return [_cell(summary[name]) for name in names]


def _cell(estimate: Estimate, mark: str = "") -> Cell:
    return Cell(*printed_parts(estimate), estimate.value, mark)


def _condition(title: str, value: str) -> Cell:
    return _count(int(value)) if title == "n" else Cell(value)


def _count(number: int) -> Cell:
    return Cell(str(number), key=number)
