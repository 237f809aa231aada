"""The project's Markdown pages as data: links, code spans, code blocks, commands."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Self

ROOT = Path(__file__).parents[2]
GENERATED = ("_build", "jupyter_execute")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += [path for path in sorted((ROOT / "docs").rglob("*.md")) if path.parts[-2] not in GENERATED]

FENCE = re.compile(r"^```(\w*|\{[\w-]+\}.*?)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A block of code, or a directive of MyST: language, or name and argument, and body."""
LINK = re.compile(r"\[([^\[\]]*)\]\(([^()\s]+)\)")
"""A link or an image: text and target."""
NEED = re.compile(r"<!-- not run: ([^>]+) -->\n\Z")
"""A comment before a block of code that says why no test runs it."""
SAVED = re.compile(r"[Ss]ave as `([^`]+)`:\n\n\Z")
"""The end of a sentence before a block of code that is a file."""
SPAN = re.compile(r"`([^`]+)`")
CREATED = re.compile(r"(?:Create|[Ss]ave as) `([^`]+)`")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
PROGRAMS = (
    *("dynahoi", "lerobot-train", "lerobot-eval", "lerobot-edit-dataset", "lerobot-dataset-viz"),
    *("accelerate", "hf", "pip", "python", "pytest", "bash", "uv"),
)
HUB_FILE = "env.py"
"""The file that an environment on the Hub consists of; not one of this project."""
CODE_SUFFIXES = (".py", ".yaml", ".md", ".toml")


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
    def links(self) -> list[tuple[str, str]]:
        """The (text, target) of every link and picture to a file or heading of the project."""
        found = [(" ".join(text.split()), target) for text, target in LINK.findall(self.prose)]
        return [
            (text, target)
            for text, target in found
            if "://" not in target and not target.startswith("mailto:")
        ]

    @property
    def anchors(self) -> set[str]:
        """What headings are called in links."""
        return {
            re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
            for heading in HEADING.findall(self.prose)
        }

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
        """What looks like the path of a file of this project, seen from the project's root."""
        words = {span for span in self.spans if " " not in span}
        words |= {part for command in self.commands for word in command for part in word.split("=")}
        return {word for word in words - {HUB_FILE, *CREATED.findall(self.text)} if _is_path(word)}


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


def _is_path(word: str) -> bool:
    if not re.fullmatch(r"[\w.\-/]+", word) or "..." in word:
        return False
    first = word.split("/", maxsplit=1)[0]
    if first in ("data", "outputs", "results") or word.endswith(
        GENERATED
    ):  # what commands may have made here
        return False
    return ("/" in word and (ROOT / first).is_dir()) or word.endswith(CODE_SUFFIXES)
