"""The project's Markdown pages as data: links, code spans, code blocks, commands."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`([^`]+)`")
LINK = re.compile(r"\[([^\[\]]*)\]\(([^()\s]+)\)")
CREATED = re.compile(r"Create `([^`]+)`")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
PROGRAMS = ("dynahoi", "lerobot-train", "lerobot-eval", "lerobot-edit-dataset", "python", "pytest", "bash")
HUB_FILE = "env.py"
"""The file that an environment on the Hub consists of; not one of this project."""
CODE_SUFFIXES = (".py", ".yaml", ".md", ".toml")


@dataclass(frozen=True)
class Page:
    """One Markdown file.

    Attributes:
        path: where it is.
        text: all of it.
    """

    path: Path
    text: str

    @classmethod
    def read(cls, path: Path) -> Page:
        return cls(path, path.read_text())

    @property
    def prose(self) -> str:
        """The text without its code blocks."""
        return FENCE.sub("", self.text)

    def blocks(self, *languages: str) -> list[str]:
        """Return the code blocks in the given languages; "" is a block without one."""
        return [body for language, body in FENCE.findall(self.text) if language in languages]

    @property
    def spans(self) -> list[str]:
        """The code spans of the prose, each on one line."""
        return [" ".join(span.split()) for span in SPAN.findall(self.prose)]

    @property
    def links(self) -> list[tuple[str, str]]:
        """The (text, target) of every link and picture to a file or heading of the project."""
        found = [(" ".join(text.split()), target) for text, target in LINK.findall(self.prose)]
        return [(text, target) for text, target in found if "://" not in target]

    @property
    def anchors(self) -> set[str]:
        """What headings are called in links."""
        return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in HEADING.findall(self.prose)}

    @property
    def commands(self) -> list[list[str]]:
        """The words of every command line in code blocks and code spans, from the program's name on."""
        lines = [line for block in self.blocks("", "bash") for line in block.replace("\\\n", " ").splitlines()]
        return [words for line in (*lines, *self.spans) if (words := _command(line))]

    @property
    def paths(self) -> set[str]:
        """What looks like the path of a file of this project, seen from the project's root."""
        words = {span for span in self.spans if " " not in span}
        words |= {part for command in self.commands for word in command for part in word.split("=")}
        return {word for word in words - {HUB_FILE, *CREATED.findall(self.text)} if _is_path(word)}


def pages() -> list[Page]:
    """Return every page."""
    return [Page.read(path) for path in PAGES]


def _command(line: str) -> list[str]:
    try:
        words = shlex.split(line, comments=True)
    except ValueError:  # a drawing, not a command
        return []
    while words and (words[0] in ("uv", "run") or re.fullmatch(r"[A-Z_]+=.*", words[0])):
        words = words[1:]
    return words if len(words) > 1 and words[0] in PROGRAMS else []


def _is_path(word: str) -> bool:
    if not re.fullmatch(r"[\w.\-/]+", word) or "..." in word:
        return False
    first = word.split("/", maxsplit=1)[0]
    return ("/" in word and (ROOT / first).is_dir()) or (word.endswith(CODE_SUFFIXES) and first != "outputs")
