"""The project's Markdown pages as data: code spans, code blocks, commands."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Self

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += sorted([*(ROOT / "docs").glob("*.md"), *(ROOT / "docs/notes").glob("*.md")])
FOLDERS = ("benchmarks", "checkpoints", "docs", "dynahoi_lerobot", "envs", "policies", "recipes")
FOLDERS += ("tests", ".ci")
"""Folders of the repository, in which a path in the text must be there."""

FENCE = re.compile(r"^```(\w*|\{[\w-]+\}.*?)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A block of code, or a directive of MyST: language, or name and argument, and body."""
NEED = re.compile(r"<!-- not run: ([^>]+) -->\n\Z")
"""A comment before a block of code that says why no test runs it."""
SAVED = re.compile(r"[Ss]ave as `([^`]+)`:\n\n\Z")
"""The end of a sentence before a block of code that is a file."""
SPAN = re.compile(r"`([^`]+)`")
CREATED = re.compile(r"(?:Create|[Ss]ave as) `([^`]+)`")
PROGRAMS = (
    *("dynahoi", "lerobot-train", "lerobot-eval", "lerobot-edit-dataset", "lerobot-dataset-viz"),
    *("accelerate", "hf", "pip", "python", "pytest", "bash", "uv"),
)


@dataclass(frozen=True)
class Block:
    """One block of code: what its fence names, the code, why no test runs it, the file that it
    shall be saved as.
    """

    language: str
    body: str
    need: str
    file: str

    @property
    def commands(self) -> list[list[str]]:
        """The words of every command line, from the program's name on."""
        lines = self.body.replace("\\\n", " ").splitlines()
        return [words for line in lines if (words := _command(line))]


@dataclass(frozen=True)
class Page:
    path: Path
    text: str

    @classmethod
    def read(cls, path: Path) -> Self:
        return cls(path, path.read_text())

    @property
    def prose(self) -> str:
        """The text without its code blocks."""
        return FENCE.sub("", self.text)

    @property
    def all_blocks(self) -> list[Block]:
        return [self._block(match) for match in FENCE.finditer(self.text)]

    def _block(self, match: re.Match[str]) -> Block:
        before = self.text[: match.start()]
        need, file = (
            found.group(1) if (found := rule.search(before)) else "" for rule in (NEED, SAVED)
        )
        return Block(match.group(1), match.group(2), need, file)

    @property
    def spans(self) -> list[str]:
        """The code spans of the prose, each on one line."""
        return [" ".join(span.split()) for span in SPAN.findall(self.prose)]

    @property
    def commands(self) -> list[list[str]]:
        """The words of every command line in code blocks and code spans, from the program's name
        on.
        """
        shown = [
            words
            for block in self.all_blocks
            if block.language in ("", "bash")
            for words in block.commands
        ]
        return shown + [words for span in self.spans if (words := _command(span))]

    @property
    def paths(self) -> set[str]:
        """Code spans that are paths in this repository, but for those that a reader creates."""
        spans = {*self.spans} - {*CREATED.findall(self.text)}
        return {
            span
            for span in spans
            if re.fullmatch(r"[\w.\-/]+", span) and "/" in span and span.split("/")[0] in FOLDERS
        }


def pages() -> list[Page]:
    return [Page.read(path) for path in PAGES]


def _command(line: str) -> list[str]:
    try:
        words = shlex.split(line, comments=True)
    except ValueError:  # a drawing, not a command
        return []
    while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
        words = words[1:]
    return words if len(words) > 1 and words[0] in PROGRAMS else []
