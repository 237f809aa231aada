"""Writes the table of damages in ``docs/verify.md`` from the tables of the test."""

from __future__ import annotations

from pathlib import Path

from tests.verify.damages import GROUPS

PAGE = Path(__file__).parents[1] / "verify.md"
BEGIN, END = "<!-- begin: python -m docs.scripts.damage_table -->\n", "<!-- end -->"
MODES = {"unsigned": "hashes", "default": "default", "decode": "`--decode`", "replay": "`--replay`"}


def with_table(page: str) -> str:
    """Return the page with today's table between its two marks."""
    before, rest = page.split(BEGIN)
    after = rest.split(END, 1)[1]
    return before + BEGIN + table() + END + after


def table() -> str:
    """Return the damages by group and mode, as a Markdown table."""
    lines = ["| what is damaged | found by | damages |", "|---|---|---|"]
    for group, damages in GROUPS.items():
        for mode, title in MODES.items():
            if names := [name for name, (_, finder, _) in damages.items() if finder == mode]:
                lines.append(f"| {group} | {title} | {'; '.join(names)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text()))
    print(PAGE)
