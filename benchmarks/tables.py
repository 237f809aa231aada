"""Write the measured figures of README and docs from docs/figures: python benchmarks/tables.py
[--stale SENTENCE]

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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from support.options import pinned_benchmark

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "docs" / "figures"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
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

    def brief(self, decimals: int = 1) -> str:
        """Return the value with so many decimals."""
        return f"{self.value:,.{decimals}f}" + (f"\0{self.note}\0" if self.note else "")

    def show(self, decimals: int = 1) -> str:
        """Return the value with its interval, for instance ``84.1 [81.7, 86.2]``."""
        ends = "" if self.low is None else f" [{self.low:.{decimals}f}, {self.high:.{decimals}f}]"
        return f"{self.value:,.{decimals}f}{ends}" + (f"\0{self.note}\0" if self.note else "")


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
    scale = 100 if node.get("unit") == "fraction" else 1
    numbers = {
        name: scale * node[name] for name in ("value", "low", "high") if node.get(name) is not None
    }
    return (
        Figure(**numbers, note=note) if numbers else None
    )  # no episode meets a metric's condition


def outdated(node: Any) -> Iterator[dict[str, Any]]:
    """Yield the parts of a file, at any depth, that are not of today and do not say so."""
    if not isinstance(node, dict) or "stale" in node:
        return
    weights = node.get("weights", {}) if "checkpoint" in node else {}
    folder = ROOT / "checkpoints" / node.get("checkpoint", "")
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
    jinja.filters |= {"brief": _shown(Figure.brief), "show": _shown(Figure.show)}
    template = jinja.get_template("tables.jinja")
    known = {path.stem: figures(json.loads(path.read_text())) for path in folder.glob("*.json")}

    def block(match: re.Match[str]) -> str:
        text = "".join(template.blocks[match[2]](template.new_context(known))).strip("\n")
        notes = dict(zip(dict.fromkeys(NOTE.findall(text)), ("†", "‡", "§", "¶"), strict=False))
        for note, mark in notes.items():
            text = text.replace(f"\0{note}\0", mark) + f"\n\n{mark} {note}"
        return f"{match[1]}\n{text}\n{match[3]}"

    return BLOCK.sub(block, page)


def _shown(write: Callable[..., str]) -> Callable[..., str]:
    """Return a filter that writes a figure, and nothing for a metric that does not apply."""
    return lambda figure, *options: "" if figure is None else write(figure, *options)


def main() -> None:
    """Write all pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--stale", metavar="SENTENCE", help="footnote of all outdated figures that have none"
    )
    args = parser.parse_args()
    for path in sorted(FIGURES.glob("*.json")) if args.stale else ():
        content = json.loads(path.read_text())
        for part in list(outdated(content)):
            part["stale"] = args.stale
            print(f"{path.name}: {part['command']} is marked as stale")
        path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n")
    for path in PAGES:
        path.write_text(rendered(path.read_text()))


if __name__ == "__main__":
    main()
