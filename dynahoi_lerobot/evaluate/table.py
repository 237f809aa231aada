"""Results as tables, which the terminal prints and the report shows."""

import hashlib
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

from dynahoi_lerobot.core.escaping import printable
from dynahoi_lerobot.evaluate.compare import paired_difference, verdict
from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.evaluate.summary import Estimate
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.metrics.columns import STRATA

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

FEWEST_MARKED = 20
"""A row of fewer episodes is neither marked as the best nor compared with marked rows."""

RESTRICTIONS = ("motions", "objects")
"""Fields of a recipe by which only some of a split's episodes are played."""
ALL = "all"
MOST_NAMED = 3
"""So many motions or objects are named; more are counted, with digits of their names' hash."""

MOST_COLUMNS = 3
"""So many evaluations stand side by side in a terminal of 100 columns."""


@dataclass(frozen=True)
class Cell:
    """One cell.

    Attributes:
        text: as printed.
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
        # a name may hold the end of a line, after which it could say anything
        head = [printable(title) for title in self.head]
        rows = [
            [printable(f"{cell.text} {cell.detail}".strip()) for cell in row] for row in self.rows
        ]
        columns = []
        for column, numeric in zip(zip(head, *rows, strict=True), self.numeric(), strict=True):
            width = max(map(len, column))
            columns.append([text.rjust(width) if numeric else text.ljust(width) for text in column])
        first, *lines = ("  ".join(line).rstrip() for line in zip(*columns, strict=True))
        rule = "-" * max(map(len, [first, *lines]))
        return "\n".join([*filter(None, [printable(self.caption)]), first, rule, *lines])

    def numeric(self) -> list[bool]:
        """Tell for each column whether it holds numbers."""
        columns = zip(*self.rows, strict=True)
        return [any(cell.key is not None for cell in column) for column in columns]

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
    """Return a row for each evaluation, in which the best value is marked if a test supports it.

    It does if the row is better than every other one under equal conditions, paired by episode,
    with p below ``SIGNIFICANT``; rows of fewer than ``FEWEST_MARKED`` episodes do not count.

    Conditions that all evaluations share are in the caption, so that the metrics fit the page; it
    names motions and objects only where not all of them were played.
    """
    played = [conditions(result) | {"n": str(len(result.rows))} for result in results]
    differing = [name for name in played[0] if len({told[name] for told in played}) > 1]
    shared = [
        f"{_titled(name)} {value}"
        for name, value in played[0].items()
        if name not in differing and not (name in RESTRICTIONS and value == ALL)
    ]
    best = _best(results, columns)
    rows = []
    for place, (label, result) in enumerate(zip(labels, results, strict=True)):
        row = [Cell(label)]
        for name in differing:
            value = played[place][name]
            row.append(Cell(value, key=int(value) if name == "n" else None))
        for name in columns:
            mark = "best" if (place, name) in best else ""
            row.append(metric_cell(result.summary[name], mark))
        rows.append(tuple(row))
    head = ("policy", *map(_titled, differing), *map(heading, columns))
    return Table(", ".join(shared), head, tuple(rows))


def kind_table(results: Results, caption: str = "") -> Table:
    """Return one row per kind of motion, each metric with its interval."""
    columns = columns_for([results])
    counts = Counter(row["kind"] for row in results.rows)
    rows = tuple(
        (
            Cell(kind),
            Cell(str(counts[kind]), key=counts[kind]),
            *(metric_cell(summary[name]) for name in columns),
        )
        for kind, summary in results.by("kind").items()
    )
    return Table(caption, ("kind", "n", *map(heading, columns)), rows)


def category_table(
    labels: Sequence[str], results: Sequence[Results], name: str, caption: str = ""
) -> Table:
    """Return a row for each evaluation and a column for each category of motion, with one metric.

    The number of episodes is in the title of a column, or in its cells where they differ.
    """
    found = [result.by("category") for result in results]
    categories = STRATA["category"].arrange({label for groups in found for label in groups})
    head = []
    columns = []
    for category in categories:
        estimates = [groups[category][name] if category in groups else None for groups in found]
        counts = {estimate.n for estimate in estimates if estimate is not None}
        title = category.replace("_", " ")
        head.append(f"{title}, n = {min(counts)}" if len(counts) == 1 else title)
        columns.append([_category_cell(estimate, len(counts) > 1) for estimate in estimates])
    rows = tuple((Cell(label), *cells) for label, *cells in zip(labels, *columns, strict=True))
    return Table(caption, ("policy", *head), rows)


def _category_cell(estimate: Estimate | None, counted: bool) -> Cell:
    """Return a cell, if ``counted`` with the number of its episodes."""
    if estimate is None:
        return Cell("")
    cell = metric_cell(estimate)
    return replace(cell, detail=f"{cell.detail} n = {estimate.n}") if counted else cell


def columns_for(results: Sequence[Results]) -> tuple[str, ...]:
    """Return the columns of the main table: S_hold, which leads under the capture rule contact, and
    ``MAIN_COLUMNS``, as far as they apply to any of the evaluations.
    """
    applying = {name for result in results for name, found in result.summary.items() if found.n}
    return tuple(name for name in ("S_hold", *MAIN_COLUMNS) if name in applying)


def conditions(result: Results) -> dict[str, str]:
    """Return what an evaluation played, by name: numbers of other episodes do not compare."""
    restricted = {name: _listed(result.info.recipe[name]) for name in RESTRICTIONS}
    return {
        "split": result.info.split,
        **restricted,
        **result.conditions,
        "benchmark": result.info.benchmark,
    }


def _listed(names: Sequence[str]) -> str:
    """Return the names of the motions or objects that were played, or, if they are many, how many
    and a hash that tells them from others; none stand for all of them.
    """
    text = ", ".join(names)
    if len(names) > MOST_NAMED:
        return f"{len(names)} (set {hashlib.sha256(text.encode()).hexdigest()[:8]})"
    return text or ALL


def _titled(condition: str) -> str:
    return condition.replace("_", " ")


def heading(name: str) -> str:
    """Return a metric's column title: its name, its printed unit, and an arrow towards better."""
    metric = METRICS[name]
    unit = {"fraction": " %", "score": ""}.get(metric.unit, f" {metric.unit}")
    return f"{name}{unit} {'↑' if metric.direction == 'higher' else '↓'}"


def metric_cell(estimate: Estimate, mark: str = "") -> Cell:
    """Return a value and its interval, fractions in per cent; nothing where the metric applies to
    no episode.
    """
    if estimate.value is None:
        return Cell("")
    digits = 1 if estimate.unit == "fraction" else 2
    value, *ends = (f"{number:z.{digits}f}" for number in estimate.shown())
    return Cell(value, f"[{', '.join(ends)}]", estimate.value, mark)


def _best(results: Sequence[Results], columns: Sequence[str]) -> set[tuple[int, str]]:
    """Return (row, metric) of the values that a test supports to be the best of rows under equal
    conditions, see ``metrics_table``.
    """
    groups: dict[tuple[str, ...], list[int]] = defaultdict(list)
    for place, result in enumerate(results):
        groups[tuple(conditions(result).values())].append(place)
    best = set()
    for places, name in product(groups.values(), columns):
        rivals = [place for place in places if results[place].summary[name].n >= FEWEST_MARKED]
        for place in rivals if len(rivals) > 1 else []:
            others = [results[other] for other in rivals if other != place]
            if all(_beats(results[place], other, name) for other in others):
                best.add((place, name))
    return best


def _beats(a: Results, b: Results, name: str) -> bool:
    """Tell whether enough episodes that both played support that A is better than B."""
    found = paired_difference(a, b, name)
    return found is not None and found.n >= FEWEST_MARKED and verdict(name, found) == 1
