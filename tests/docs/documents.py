"""The project's Markdown pages as data: blocks of code, code spans, commands."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += sorted([*(ROOT / "docs").glob("*.md"), *(ROOT / "docs/notes").glob("*.md")])
NEED = re.compile(r"<!-- not run: (.+) -->")
"""A comment before a block of code that says why no test runs it."""
SAVED = re.compile(r"[Ss]ave as `([^`]+)`:$")
"""The end of a paragraph before a block of code that is a file."""
PROGRAMS = (
    *("dynahoi", "lerobot-train", "lerobot-eval", "lerobot-edit-dataset", "lerobot-dataset-viz"),
    *("accelerate", "hf", "pip", "python", "pytest", "bash", "uv"),
)


@dataclass(frozen=True)
class Block:
    """One block of code: its language, the code, why no test runs it, the file to save it as."""

    language: str
    body: str
    need: str
    file: str

    @property
    def commands(self) -> list[list[str]]:
        """The words of every command line, from the program's name on."""
        return _commands(self.body.replace("\\\n", " ").splitlines())


@dataclass(frozen=True)
class Page:
    path: Path
    blocks: list[Block]
    spans: list[str]
    """The code spans of the text, each on one line."""

    @classmethod
    def read(cls, path: Path) -> Self:
        blocks = []
        spans = []
        before = ""
        for token in MarkdownIt().enable("table").parse(path.read_text()):
            if token.type == "fence":
                need = "".join(NEED.findall(before))
                file = "".join(SAVED.findall(before))
                blocks.append(Block(token.info, token.content, need, file))
            for child in token.children or ():
                if child.type == "code_inline":
                    spans.append(child.content)
            before = token.content.rstrip() or before
        return cls(path, blocks, spans)

    @property
    def commands(self) -> list[list[str]]:
        """The words of every command line in blocks of code and code spans."""
        shown = [words for block in self.blocks for words in block.commands]
        return shown + _commands(self.spans)


def pages() -> list[Page]:
    return [Page.read(path) for path in PAGES]


def _commands(lines: list[str]) -> list[list[str]]:
    """The words of each line that is a command."""
    return [words for words in map(_command, lines) if words]


def _command(line: str) -> list[str]:
    try:
        words = shlex.split(line, comments=True)
    except ValueError:  # not a command
        return []
    while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
        words = words[1:]
    return words if len(words) > 1 and words[0] in PROGRAMS else []
