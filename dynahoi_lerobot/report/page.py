"""``render_report``: one self-contained HTML page from any number of result folders."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from dynahoi_lerobot.foundation.atomic import write_atomically
from dynahoi_lerobot.report.clips import find_clips
from dynahoi_lerobot.report.entries import Entry, distinct_episodes, read_entries
from dynahoi_lerobot.report.figures.base import in_order
from dynahoi_lerobot.report.tables import (
    comparison_tables,
    glossary,
    main_metrics,
    other_metrics,
    stratum_tables,
)

FILE_NAME = "report.html"


def render_report(
    folders: Sequence[Path], out: Path, *, across: Collection[str] = (), allow_version_mismatch: bool = False
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
        ResultsError: if a folder is missing or damaged.
        MixedError: for different versions of the benchmark, unless that is allowed.
        ValueError: if no folder is given.
    """
    if not folders:
        raise ValueError("a report needs at least one result folder, got none")
    entries = read_entries(folders, allow_version_mismatch=allow_version_mismatch)
    html = _template().render(**page_content(entries, across))
    page = Path(out) / FILE_NAME if Path(out).is_dir() else Path(out)
    write_atomically({page: lambda path: path.write_text(html, encoding="utf-8")})
    return page


def page_content(entries: Sequence[Entry], across: Collection[str] = ()) -> dict[str, Any]:
    """Return the template's variables."""
    figures = [(figure, figure.render(entries)) for figure in in_order()]
    return {
        "entries": entries,
        "episodes": len(distinct_episodes(entries)),
        "main_metrics": main_metrics(entries),
        "other_metrics": other_metrics(entries),
        "comparisons": comparison_tables(entries, across),
        "figures": [(figure, address) for figure, address in figures if address],
        "per_kind": stratum_tables(entries, "kind"),
        "glossary": glossary(),
        "clips": find_clips(entries),
    }


def _template() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader(Path(__file__).with_name("templates"))
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    return environment.get_template("report.html.j2")
