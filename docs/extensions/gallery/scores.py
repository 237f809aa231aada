"""The scores that the benchmark's page holds, so that no number is written down twice."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "benchmark.md"
TABLE = re.compile(r"(?:^\|.*\|\n)+", re.MULTILINE)
Rows = list[list[str]]


def tables() -> list[Rows]:
    """Return every table of the page as rows of cells, the header first, without the line below it."""
    found = []
    for table in TABLE.findall(PAGE.read_text()):
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
        found.append([rows[0], *rows[2:]])
    return found


def of_stratum(label: str) -> Rows:
    """Return who scores what [%] on a stratum of episodes or under a condition, a column for each table that has it.

    The first row is the header, with the metric and control class of each; empty if the page has no such scores.

    Args:
        label: a category of motions, an object, a hand ("opposed hand"), a view or a switch of the appearance.
    """
    title = label.replace("_", " ")
    found = [table for table in tables() if title in table[0]]
    if not found:
        return []
    header = ["", *(table[0][0] for table in found)]
    columns = [[row[table[0].index(title)] for row in table[1:]] for table in found]
    return [header, *([row[0], *values] for row, *values in zip(found[0][1:], *columns, strict=True))]


def of_metric(name: str) -> Rows:
    """Return the privileged baselines' values of a metric, a column for each control class that the page has."""
    for header, *rows in tables():
        classes = _control_classes(header)
        columns = [i for i, title in enumerate(header) if f"{name} " in f"{title} " and classes[i]]
        if columns:
            return [
                ["", *(f"{name} %, {classes[i]}" for i in columns)],
                *([row[0], *(row[i] for i in columns)] for row in rows),
            ]
    return []


def _control_classes(header: list[str]) -> list[str]:
    """Return the control class of each column: that in its title, or the last one before."""
    classes, current = [], ""
    for title in header:
        named = re.match(r"`\w+`", title)
        current = named.group() if named else current
        classes.append(current)
    return classes
