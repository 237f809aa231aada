"""Results as tables, which the terminal prints and the report shows."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from dynahoi_lerobot.evaluate.results import CONDITIONS, Results
from dynahoi_lerobot.evaluate.summary import Estimate
from dynahoi_lerobot.metrics import METRICS

MAIN_COLUMNS = (
    "S_loc",
    "S_joint",
    "S_gra_two_sided",
    "S_gra",
    "E_loc",
    "E_gra",
    "Q_smooth",
    "Q_line",
    "R_time",
)
"""The paper's seven metrics, and beside its S_gra, which a fist passes, the grasp that a fist
fails."""

TITLES = ("split", *(name.replace("_", " ") for name in CONDITIONS), "benchmark", "n")
"""Titles of what is said about an evaluation beside its numbers: under others they do not
compare."""

MOST_COLUMNS = 3
"""So many evaluations stand side by side in a terminal of 100 columns."""


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

    def as_text(self) -> str:
        """Return the lines of the table, its caption on top and columns with numbers flush
        right.
        """
        texts = [
            [" ".join(filter(None, (cell.text, cell.detail))) for cell in row] for row in self.rows
        ]
        columns = [list(column) for column in zip(self.head, *texts, strict=True)]
        for i, column in enumerate(columns):
            width, right = max(map(len, column)), any(row[i].key is not None for row in self.rows)
            columns[i] = [text.rjust(width) if right else text.ljust(width) for text in column]
        lines = ["  ".join(line).rstrip() for line in zip(*columns, strict=True)]
        return "\n".join(
            [*filter(None, [self.caption]), lines[0], "-" * max(map(len, lines)), *lines[1:]]
        )

    def turned(self) -> "Table":
        """Return it with rows for columns."""
        title, *head = self.head
        names, *columns = zip(*self.rows, strict=True)
        rows = tuple((Cell(name), *column) for name, column in zip(head, columns, strict=True))
        return Table(self.caption, (title, *(cell.text for cell in names)), rows)


def results_table(results: Sequence[Results]) -> str:
    """Return a column for each evaluation, or, if there are many, a line, each metric with its
    interval.

    What all of them share is in the first line; an asterisk marks the privileged.
    """
    names = [result.info.policy + "*" * result.privileged for result in results]
    table = metrics_table(names, results, columns_for(results))
    text = (table.turned() if len(results) <= MOST_COLUMNS else table).as_text()
    return text + "\n* privileged: knows the simulator's state" * any(
        result.privileged for result in results
    )


def metrics_table(
    labels: Sequence[str], results: Sequence[Results], columns: Sequence[str]
) -> Table:
    """Return a row for each evaluation; the best of those under equal conditions is marked.

    Conditions that all evaluations share are in the caption, so that the metrics fit the page.
    """
    found = [conditions(result) for result in results]
    differing = [i for i, values in enumerate(zip(*found, strict=True)) if len(set(values)) > 1]
    shared = [f"{title} {found[0][i]}" for i, title in enumerate(TITLES) if i not in differing]
    best = _best(results, columns)
    rows = tuple(
        (
            Cell(label),
            *(
                Cell(found[place][i], key=len(result.rows) if TITLES[i] == "n" else None)
                for i in differing
            ),
            *(
                metric_cell(result.summary[name], "best" if (place, name) in best else "")
                for name in columns
            ),
        )
        for place, (label, result) in enumerate(zip(labels, results, strict=True))
    )
    return Table(
        ", ".join(shared),
        ("policy", *(TITLES[i] for i in differing), *map(heading, columns)),
        rows,
    )


def kind_table(results: Results, caption: str = "") -> Table:
    """Return one row per kind of motion, each metric with its interval."""
    columns, counts = columns_for([results]), Counter(row["kind"] for row in results.rows)
    rows = tuple(
        (
            Cell(kind),
            Cell(str(counts[kind]), key=counts[kind]),
            *(metric_cell(summary[name]) for name in columns),
        )
        for kind, summary in results.by("kind").items()
    )
    return Table(caption, ("kind", "n", *map(heading, columns)), rows)


def columns_for(results: Sequence[Results]) -> tuple[str, ...]:
    """Return the main columns, led by S_hold if any evaluation uses the capture rule contact."""
    return ("S_hold",) * any(r.info.capture == "contact" for r in results) + MAIN_COLUMNS


def conditions(result: Results) -> list[str]:
    """Return what ``TITLES`` name about an evaluation."""
    return [
        result.info.split,
        *result.conditions.values(),
        result.info.benchmark,
        str(len(result.rows)),
    ]


def heading(name: str) -> str:
    """Return a metric's column title: its name, its printed unit, and an arrow towards better."""
    metric = METRICS[name]
    unit = {"fraction": " %", "score": ""}.get(metric.unit, f" {metric.unit}")
    return f"{name}{unit} {'↑' if metric.direction == 'higher' else '↓'}"


def metric_cell(estimate: Estimate, mark: str = "") -> Cell:
    """Return a value and its interval, fractions in per cent; a dash where no episode meets the
    condition.
    """
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return Cell("-")
    scale, digits = (100, 1) if estimate.unit == "fraction" else (1, 2)
    value, *ends = (
        f"{scale * end:.{digits}f}" for end in (estimate.value, estimate.low, estimate.high)
    )
    return Cell(value, f"[{', '.join(ends)}]", estimate.value, mark)


def _best(results: Sequence[Results], columns: Sequence[str]) -> set[tuple[int, str]]:
    """Return (row, metric) of the best values among rows under equal conditions, if there are two
    at least.
    """
    groups: dict[tuple[str, ...], list[int]] = defaultdict(list)
    for place, result in enumerate(results):
        groups[tuple(conditions(result)[:-1])].append(place)
    best = set()
    for places, name in product(groups.values(), columns):
        known = {
            place: value
            for place in places
            if (value := results[place].summary[name].value) is not None
        }
        if len(known) > 1:
            top = (
                max(known.values()) if METRICS[name].direction == "higher" else min(known.values())
            )
            best |= {(place, name) for place, value in known.items() if value == top}
    return best
