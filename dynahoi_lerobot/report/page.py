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
from dynahoi_lerobot.core.files import write_text_atomically
from dynahoi_lerobot.core.reading import ReadError, inside, read_bytes
from dynahoi_lerobot.evaluate import table
from dynahoi_lerobot.evaluate.compare import (
    CROSSABLE,
    paired_difference,
    paired_values,
    unequal_conditions,
)
from dynahoi_lerobot.evaluate.results import Results, RunInfo
from dynahoi_lerobot.evaluate.table import Cell, Table
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.metrics.columns import COMMANDS
from dynahoi_lerobot.report import figures
from dynahoi_lerobot.report.comparisons import comparison_tables
from dynahoi_lerobot.report.entries import Entry, distinct_episodes, read_entries
from dynahoi_lerobot.report.export import category_tables, write_csv, write_latex

FILE_NAME = "report.html"

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
    csv: Path | None = option(None, "also write every number of the tables as CSV", metavar="FILE")
    latex: Path | None = option(None, "also write the tables as LaTeX", metavar="FILE")


def run(options: Options) -> int:
    """Write the page and the files for a paper, and print the tables; return the exit code."""
    entries = read_entries(options.folders, allow_version_mismatch=options.allow_version_mismatch)
    page = write_page(entries, options.out, options.across)
    if options.csv:
        write_csv(entries, options.csv, options.across)
    if options.latex:
        write_latex(entries, options.latex, options.across)
    print(table.results_table([entry.results for entry in entries]))
    pairs = list(combinations(entries, 2))
    apart = {(a, b): _apart(a.results, b.results, options.across) for a, b in pairs}
    for names in sorted({*apart.values()} - {()}):
        never = [name for name in names if name not in CROSSABLE]
        across = " ".join(f"--across {name}" for name in names)
        remedy = f"with different {never[0]} none can be" if never else f"{across} pairs them"
        print(f"evaluations with different {' and '.join(names)} are not paired; {remedy}")
    for a, b in pairs if options.across else []:
        if not apart[a, b]:
            print(_difference(a, b))
    print(f"report: {page}")
    return 0


def _apart(a: Results, b: Results, across: Collection[str]) -> tuple[str, ...]:
    """Return what keeps two evaluations from being paired: what gave them other episodes, or else
    the conditions in which they differ.
    """
    if paired_values(a, b, "S_loc").size:
        return tuple(unequal_conditions(a, b, across))
    told, other = map(table.conditions, (a, b))
    names = ("split", *table.RESTRICTIONS)
    return tuple(name for name in names if told[name] != other[name]) or ("episodes",)


def _difference(a: Entry, b: Entry) -> str:
    loc = paired_difference(a.results, b.results, "S_loc")
    apart = paired_difference(a.results, b.results, COMMANDS)
    if loc is None or apart is None:
        return f"{a.label} and {b.label} share no episode"
    value, low, high = loc.shown()
    points = f"S_loc {value:+.1f} [{low:+.1f}, {high:+.1f}] points"
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
        folders: result folders; duplicates count once, and one that cannot be read or is
            unfinished is left out, with a warning that says why.
        out: the file to write, or an existing folder in which ``report.html`` is written.
        across: conditions under which paired evaluations may differ, of ``CROSSABLE``.
        allow_version_mismatch: accept results of different benchmark versions.

    Returns:
        The path of the page.

    Raises:
        ReadError: if all of the folders are left out.
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
    write_text_atomically(page, html)
    return page


def page_content(entries: Sequence[Entry], across: Collection[str] = ()) -> dict[str, Any]:
    """Return the template's variables."""
    labels = [entry.label for entry in entries]
    results = [entry.results for entry in entries]
    main = table.columns_for(results)
    other = [name for name in METRICS.names() if name not in main]
    clips = [(entry.label, *clips_of(entry.results.folder)) for entry in entries]
    return {
        "entries": entries,
        "episodes": len(distinct_episodes(entries)),
        "main_metrics": table.metrics_table(labels, results, main),
        "other_metrics": table.metrics_table(labels, results, other),
        "fewest_marked": table.FEWEST_MARKED,
        "defined": {name: METRICS[name].summary for name in main},
        "categories": category_tables(entries),
        "comparisons": comparison_tables(entries, across),
        "figures": figures.rendered(entries),
        "per_kind": [table.kind_table(entry.results, entry.label) for entry in entries],
        "glossary": glossary(),
        "facts": [facts(entry.results.info) for entry in entries],
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
                    metric.doc.replace("``", ""),
                ),
            )
        )
        for name, metric in METRICS.items()
    )
    return Table(
        "Definitions of all metrics.", ("metric", "unit", "better", "episodes", "definition"), rows
    )


def facts(info: RunInfo) -> dict[str, str]:
    """Return the recipe of an evaluation and what ``RunInfo.extra`` tells of it, in words; nothing
    of empty parts.
    """
    told = {"recipe": info.recipe} | info.extra
    words = {key: in_words(value) for key, value in told.items()}
    return {key: text for key, text in words.items() if text}


def in_words(value: Any) -> str:
    """Return a JSON value as ``name value`` pairs or a list, without quotes; empty for nothing."""
    if isinstance(value, dict):
        told = {key: in_words(item) for key, item in value.items()}
        return ", ".join(f"{key} {text}" for key, text in told.items() if text)
    if isinstance(value, list | tuple):
        return ", ".join(map(in_words, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else str(value)


def clips_of(folder: Path) -> tuple[list[tuple[str, str]], int]:
    """Return the names of a folder's first GIFs with their ``data:`` addresses, and the number of
    those left out.
    """
    clips = []
    for file in sorted(folder.glob("*.gif")):
        with suppress(ReadError):  # a link could embed any file
            content = read_bytes(inside(folder, file.name))
            if content.startswith(GIF_HEADERS) and len(content) <= LARGEST_CLIP_BYTES:
                clips.append((printable(file.stem), data_url("image/gif", content)))
    return clips[:MOST_CLIPS], len(clips[MOST_CLIPS:])
