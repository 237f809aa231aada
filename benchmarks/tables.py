"""Write the measured figures of README and docs from docs/figures.

    python benchmarks/tables.py
    python benchmarks/tables.py --stale SENTENCE

Benchmarks leave a JSON file there (`--json docs/figures/NAME.json`), with the command, commit,
processor and, for scores, the pinned benchmark and the weights. A page shows the block NAME of
docs/figures/tables.jinja between `<!-- figures: NAME -->` and `<!-- end of figures -->`. Figures of
another benchmark or of other weights than today's must have a sentence under `stale`, which becomes
a footnote. `--stale` gives it to all that lack one and need it.
"""

import argparse
import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from support.options import REPOSITORY, pinned_benchmark

FIGURES = REPOSITORY / "docs" / "figures"
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]
BLOCK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(\n<!-- end of figures -->)", re.DOTALL)
NOTE = re.compile("\0(.*?)\0")
PROVENANCE = {"command", "commit", "processor"}
NOT_MEASURED = {"settings", "machine", "benchmark", "weights"}


@dataclass(frozen=True)
class Figure:
    """A measured value, in % if it is a fraction, the ends of its interval if it has one, and its
    footnote.
    """

    value: float
    low: float | None = None
    high: float | None = None
    note: str = ""


def brief(figure: Figure | None, decimals: int = 1) -> str:
    """Return the value with so many decimals; nothing for a metric that does not apply."""
    return "" if figure is None else f"{figure.value:,.{decimals}f}{_mark(figure)}"


def show(figure: Figure | None, decimals: int = 1) -> str:
    """Return what ``brief`` does, with the interval, for instance ``84.1 [81.7, 86.2]``."""
    if figure is None or figure.low is None:
        return brief(figure, decimals)
    ends = f"[{figure.low:.{decimals}f}, {figure.high:.{decimals}f}]"
    return f"{figure.value:,.{decimals}f} {ends}{_mark(figure)}"


def _mark(figure: Figure) -> str:
    """Return the footnote between characters that no page has; ``rendered`` puts a sign there."""
    return f"\0{figure.note}\0" if figure.note else ""


def figures(node: Any, note: str = "") -> Any:
    """Return what a file holds, with a ``Figure`` for every number; ``stale`` concerns all below
    it.
    """
    if isinstance(node, list):
        return [figures(entry, note) for entry in node]
    if isinstance(node, int | float):
        return Figure(node, note=note)
    if not isinstance(node, dict):
        return node
    note = node.get("stale", note)
    if "value" not in node:
        return {key: figures(entry, note) for key, entry in node.items() if key != "stale"}
    if node["value"] is None:  # no episode meets the metric's condition
        return None
    scale = 100 if node.get("unit") == "fraction" else 1
    ends = {name: scale * node[name] for name in ("low", "high") if node.get(name) is not None}
    return Figure(scale * node["value"], **ends, note=note)


def outdated(node: Any) -> Iterator[dict[str, Any]]:
    """Yield the parts of a file, at any depth, that are not of today and do not say so."""
    if not isinstance(node, dict) or "stale" in node:
        return
    weights = node.get("weights", {}) if "checkpoint" in node else {}
    folder = REPOSITORY / "checkpoints" / node.get("checkpoint", "")
    there = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in weights}
    if node.get("benchmark", pinned_benchmark()) != pinned_benchmark() or there != weights:
        yield node
    for entry in node.values():
        yield from outdated(entry)


def unexplained(node: Any, where: str, known: frozenset[str] = frozenset()) -> Iterator[str]:
    """Yield the places of numbers for which a file does not say the command, commit and
    processor.
    """
    if isinstance(node, dict):
        for key in node.keys() - NOT_MEASURED:
            yield from unexplained(node[key], f"{where}/{key}", known | node.keys())
    elif isinstance(node, int | float) and not known >= PROVENANCE:
        yield where


def rendered(page: str, folder: Path = FIGURES) -> str:
    """Return the text of a page with the figures of a folder."""
    jinja = Environment(
        loader=FileSystemLoader(folder), undefined=StrictUndefined, trim_blocks=True
    )
    jinja.filters |= {"brief": brief, "show": show}
    template = jinja.get_template("tables.jinja")
    known = {path.stem: figures(json.loads(path.read_text())) for path in folder.glob("*.json")}

    def block(match: re.Match[str]) -> str:
        text = "".join(template.blocks[match[2]](template.new_context(known))).strip("\n")
        notes = dict(zip(dict.fromkeys(NOTE.findall(text)), ("†", "‡", "§", "¶"), strict=False))
        for note, mark in notes.items():
            text = text.replace(f"\0{note}\0", mark) + f"\n\n{mark} {note}"
        return f"{match[1]}\n{text}\n{match[3]}"

    return BLOCK.sub(block, page)


def main() -> None:
    """Write all pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--stale", metavar="SENTENCE", help="footnote of all outdated figures that have none"
    )
    args = parser.parse_args()
    if args.stale:
        mark_stale(args.stale)
    for path in PAGES:
        path.write_text(rendered(path.read_text()))


def mark_stale(sentence: str) -> None:
    """Give a footnote to all outdated figures that have none, and print which they are."""
    for path in sorted(FIGURES.glob("*.json")):
        content = json.loads(path.read_text())
        for part in list(outdated(content)):
            part["stale"] = sentence
            print(f"{path.name}: {part['command']} is marked as stale")
        path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
