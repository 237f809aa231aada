"""``dynahoi report`` and ``render_report``: one self-contained HTML page from any number of result
folders.
"""

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.arguments import argument, option
from dynahoi_lerobot.core.escaping import data_url, printable
from dynahoi_lerobot.core.files import write_atomically
from dynahoi_lerobot.core.reading import ReadError, inside, read_bytes
from dynahoi_lerobot.evaluate import table
from dynahoi_lerobot.evaluate.compare import COMMANDS, CROSSABLE, compare, unequal_conditions
from dynahoi_lerobot.evaluate.table import Cell, Table
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.report import figures
from dynahoi_lerobot.report.entries import Entry, distinct_episodes, read_entries

FILE_NAME = "report.html"

COMPARED = {
    **{
        name: f"{table.heading(name)}: row minus column."
        for name in ("S_hold", "S_loc", "S_joint", "E_loc")
    },
    COMMANDS: "Mean distance of the palm positions that they commanded in the same frames [cm].",
}
"""What paired evaluations are compared by, with the captions; metrics without pairs are omitted."""
SIGNIFICANT = 0.05
MOST_CLIPS = 12
"""Clips shown per folder, the first by name; more would make the page too large."""
LARGEST_CLIP_BYTES = 5_000_000
GIF_HEADERS = (b"GIF87a", b"GIF89a")


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi report``."""

    folders: list[Path] = argument("result folders of `dynahoi evaluate`", nargs="+")
    allow_version_mismatch: bool = option(False, "accept results of different benchmark versions")
    across: list[str] = option(
        list,
        "also pair evaluations that differ in this condition; may be repeated",
        choices=CROSSABLE,
    )
    out: Path = option(Path("report.html"), "output file")


def run(options: Options) -> int:
    """Write the page and print the tables; return the exit code."""
    entries = read_entries(options.folders, allow_version_mismatch=options.allow_version_mismatch)
    page = write_page(entries, options.out, options.across)
    print(table.results_table([entry.results for entry in entries]))
    pairs = list(combinations(entries, 2))
    for name in CROSSABLE:
        if any(name in unequal_conditions(a.results, b.results, options.across) for a, b in pairs):
            print(f"evaluations with different {name} are not paired; --across {name} pairs them")
    for a, b in pairs if options.across else []:
        if not unequal_conditions(a.results, b.results, options.across):
            print(_difference(a, b, options.across))
    print(f"report: {page}")
    return 0


def _difference(a: Entry, b: Entry, across: list[str]) -> str:
    loc, apart = (
        compare(a.results, b.results, name, across=across, allow_version_mismatch=True)
        for name in ("S_loc", COMMANDS)
    )
    if loc is None or apart is None:
        return f"{a.label} and {b.label} share no episode"
    points = f"S_loc {100 * loc.value:+.1f} [{100 * loc.low:+.1f}, {100 * loc.high:+.1f}] points"
    commands = f"commands {apart.value:.2f} [{apart.low:.2f}, {apart.high:.2f}] cm apart"
    return f"{a.label} minus {b.label}, {loc.n} episodes: {points}, {commands}"


def render_report(
    folders: Sequence[Path],
    out: Path,
    *,
    across: Collection[str] = (),
    allow_version_mismatch: bool = False,
) -> Path:
    """Write the report of ``folders`` as one self-contained HTML page.

    Args:
        folders: result folders; duplicates count once.
        out: the file to write, or an existing folder in which ``report.html`` is written.
        across: conditions under which paired evaluations may differ, of ``CROSSABLE``.
        allow_version_mismatch: accept results of different benchmark versions.

    Returns:
        The path of the page.

    Raises:
        ReadError: if a folder is missing or damaged.
        ValueError: if no folder is given, or for different versions of the benchmark, unless that
            is allowed.
    """
    if not folders:
        raise ValueError("a report needs at least one result folder, got none")
    entries = read_entries(folders, allow_version_mismatch=allow_version_mismatch)
    return write_page(entries, out, across)


def write_page(entries: Sequence[Entry], out: Path, across: Collection[str] = ()) -> Path:
    """Write the page of ``entries`` as ``render_report`` does, and return its path."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader(Path(__file__).with_name("templates"))
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    html = environment.get_template("report.html.j2").render(**page_content(entries, across))
    page = Path(out) / FILE_NAME if Path(out).is_dir() else Path(out)
    write_atomically({page: lambda path: path.write_text(html, encoding="utf-8")})
    return page


def page_content(entries: Sequence[Entry], across: Collection[str] = ()) -> dict[str, Any]:
    """Return the template's variables."""
    labels, results = [entry.label for entry in entries], [entry.results for entry in entries]
    main = table.columns_for(results)
    other = [name for name in METRICS.names() if name not in main]
    drawn = [(figure, figure.render(entries)) for figure in figures.FIGURES]
    clips = [(entry.label, *clips_of(entry.results.folder)) for entry in entries]
    return {
        "entries": entries,
        "episodes": len(distinct_episodes(entries)),
        "main_metrics": table.metrics_table(labels, results, main),
        "other_metrics": table.metrics_table(labels, results, other),
        "comparisons": comparison_tables(entries, across),
        "figures": [(figure, address) for figure, address in drawn if address],
        "per_kind": [table.kind_table(entry.results, entry.label) for entry in entries],
        "glossary": glossary(),
        "clips": [(label, shown, left_out) for label, shown, left_out in clips if shown],
    }


def glossary() -> Table:
    """Return the definition of every registered metric: unit, direction, condition, formula and
    source.
    """
    arrows = {"higher": "↑ higher", "lower": "↓ lower"}
    rows = tuple(
        tuple(
            map(
                Cell,
                (
                    name,
                    metric.unit,
                    arrows[metric.direction],
                    metric.condition or "all",
                    metric.doc,
                ),
            )
        )
        for name, metric in METRICS.items()
    )
    return Table(
        "Definitions of all metrics.", ("metric", "unit", "better", "episodes", "definition"), rows
    )


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


def _compared(row: Entry, column: Entry, name: str, across: Collection[str]) -> Cell:
    if unequal := unequal_conditions(row.results, column.results, across):
        return Cell("–", f"other {' and '.join(unequal)}")
    result = compare(row.results, column.results, name, across=across, allow_version_mismatch=True)
    if row is column or result is None:
        return Cell("–")
    cell = table.metric_cell(result)
    if result.p_value is None:
        return Cell(cell.text, f"{cell.detail} n = {result.n}", cell.key)
    p_value = "p < 0.001" if result.p_value < 0.001 else f"p = {result.p_value:.3f}"
    better = (result.value > 0) == (METRICS[name].direction == "higher")
    mark = (
        ("better" if better else "worse") if result.p_value < SIGNIFICANT and result.value else ""
    )
    return Cell(cell.text, f"{cell.detail} {p_value}, n = {result.n}", cell.key, mark)


def clips_of(folder: Path) -> tuple[list[tuple[str, str]], int]:
    """Return the names of a folder's first GIFs with their ``data:`` addresses, and the number of
    those left out.
    """
    clips = []
    for file in sorted(folder.glob("*.gif")):
        with suppress(ReadError):  # a link could embed any file
            content = read_bytes(inside(folder, file.name), LARGEST_CLIP_BYTES)
            if content.startswith(GIF_HEADERS):
                clips.append((printable(file.stem), data_url("image/gif", content)))
    return clips[:MOST_CLIPS], len(clips[MOST_CLIPS:])
