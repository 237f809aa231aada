"""The evaluations of one report in pairs: matrices for the page, each pair once for a paper."""

from collections.abc import Collection, Iterator, Sequence
from itertools import combinations

from dynahoi_lerobot.evaluate import table
from dynahoi_lerobot.evaluate.compare import (
    Comparison,
    paired_difference,
    unequal_conditions,
    verdict,
)
from dynahoi_lerobot.evaluate.table import Cell, Table
from dynahoi_lerobot.metrics.columns import COMMANDS
from dynahoi_lerobot.report.entries import Entry

COMPARED = {
    **{
        name: f"{table.heading(name)}: row minus column."
        for name in ("S_hold", "S_loc", "S_joint", "E_loc")
    },
    COMMANDS: "Mean distance of the palm positions that they commanded in the same frames [cm].",
}
"""What paired evaluations are compared by, with the captions; metrics without pairs are omitted."""
MARKS = {1: "better", 0: "", -1: "worse"}
"""CSS class of a difference that a test supports."""


def comparison_tables(entries: Sequence[Entry], across: Collection[str] = ()) -> list[Table]:
    """Return a matrix for each of ``COMPARED`` on the episodes that row and column both played.

    Only evaluations under equal conditions are paired, except for those that are compared,
    ``across``.
    """
    tables = []
    for name, caption in COMPARED.items():
        cells = [[_compared(row, column, name, across) for column in entries] for row in entries]
        if any(cell.key is not None for line in cells for cell in line):
            rows = tuple(
                (Cell(entry.label), *line) for entry, line in zip(entries, cells, strict=True)
            )
            tables.append(
                Table(caption, ("row, column", *(entry.label for entry in entries)), rows)
            )
    return tables


def pairs(
    entries: Sequence[Entry], across: Collection[str] = ()
) -> Iterator[tuple[Entry, Entry, str, Comparison]]:
    """Yield every two evaluations that may be paired, once, with each of ``COMPARED`` and A - B."""
    for a, b in combinations(entries, 2):
        if unequal_conditions(a.results, b.results, across):
            continue
        for name in COMPARED:
            found = paired_difference(a.results, b.results, name)
            if found is not None:
                yield a, b, name, found


def pairs_table(entries: Sequence[Entry], across: Collection[str] = ()) -> Table:
    """Return a row for each of ``pairs``: difference, interval, number of episodes and p-value."""
    rows = []
    for a, b, name, found in pairs(entries, across):
        cell = table.metric_cell(found)
        title = f"{COMMANDS} cm" if name == COMMANDS else table.heading(name)
        p_value = "" if found.p_value is None else _p_text(found.p_value)
        numbers = (
            Cell(cell.text, key=found.value),
            Cell(cell.detail, key=found.low),
            Cell(str(found.n), key=found.n),
            Cell(p_value, key=found.p_value),
        )
        rows.append((Cell(a.label), Cell(b.label), Cell(title), *numbers))
    head = ("A", "B", "metric", "A – B", "95 % interval", "n", "p")
    return Table("Paired differences, on the episodes that both played.", head, tuple(rows))


def _compared(row: Entry, column: Entry, name: str, across: Collection[str]) -> Cell:
    unequal = unequal_conditions(row.results, column.results, across)
    if unequal:
        return Cell("–", f"other {' and '.join(unequal)}")
    result = paired_difference(row.results, column.results, name)
    if row is column or result is None:
        return Cell("–")
    cell = table.metric_cell(result)
    if result.p_value is None:
        return Cell(cell.text, f"{cell.detail} n = {result.n}", cell.key)
    sign = "" if result.p_value < LEAST_P else "= "
    p_value = f"p {sign}{_p_text(result.p_value)}"
    mark = MARKS[verdict(name, result)]
    return Cell(cell.text, f"{cell.detail} {p_value}, n = {result.n}", cell.key, mark)


LEAST_P = 0.001


def _p_text(p_value: float) -> str:
    return f"< {LEAST_P}" if p_value < LEAST_P else f"{p_value:.3f}"
