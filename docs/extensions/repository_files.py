"""Sphinx extension: pages for the files of the repository that the documentation links to.

On a code host such links open the file. Here each leads to a page below ``files/``: Markdown is shown as a page, other
files with their syntax in colour, folders as a list. So the site needs no address of a repository.
"""

from __future__ import annotations

import functools
import os
import re
from pathlib import Path

from sphinx.application import Sphinx

from docs.extensions.api_pages import folder_of
from docs.extensions.generated import write_pages
from docs.extensions.markdown import LINK, is_local, map_links

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
FOLDER = "files"
ALWAYS = [ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
"""Files that have a place in the site's table of contents."""
TESTED = ("motions", "objects", "hands", "renderers", "sampling", "metrics")
"""Folders of the tests that the gallery's pages link to."""

GENERATED = ("api", "gallery", "notebooks", FOLDER, "_build")
CARD_DATA = re.compile(r"\A---\n.*?^---\n", re.MULTILINE | re.DOTALL)
"""What the Hub reads at the beginning of a card."""
LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml", ".json": "json", ".sh": "bash", ".svg": "xml"}
PICTURES = (".gif", ".png", ".jpg", ".svg")


def written_pages() -> list[Path]:
    """Return the Markdown files below ``docs`` that people wrote."""
    return list(filter(_is_written, sorted(DOCS.rglob("*.md"))))


def _is_written(path: Path) -> bool:
    return path.is_file() and path.relative_to(DOCS).parts[0] not in GENERATED


@functools.cache
def linked_files() -> list[Path]:
    """Return the files and folders that need a page: what the pages lead to outside of themselves, and what those do.

    Raises:
        FileNotFoundError: if a link leads nowhere, naming page and target.
    """
    found: set[Path] = set()
    todo = [*written_pages(), *ALWAYS, *(path for room in TESTED for path in (ROOT / "tests" / room).glob("test_*.py"))]
    while todo:
        path = todo.pop()
        if _needs_page(path):
            found.add(path)
        todo += [other for other in _leads_to(path) if _needs_page(other) and other not in found]
    return sorted(found)


def pages() -> dict[str, str]:
    """Return the text of every page by its path below ``docs``."""
    return {_page_of(path).relative_to(DOCS).as_posix(): _text(path) for path in linked_files()}


def _leads_to(path: Path) -> list[Path]:
    """Return what a folder holds, or what a Markdown file links to."""
    if path.is_dir():
        return _children(path)
    if path.suffix != ".md":
        return []
    return [_resolved(path, target) for _, target in LINK.findall(path.read_text()) if is_local(target)]


def relinked(text: str, origin: Path, page: Path) -> str:
    """Return Markdown of the file ``origin`` with links that hold on the site's ``page``, which shows it."""

    def change(target: str) -> str:
        name, mark, anchor = target.partition("#")
        path = _resolved(origin, name)
        return os.path.relpath(_page_of(path), page.parent) + mark + anchor

    return map_links(text, change)


def _resolved(origin: Path, target: str) -> Path:
    path = (origin.parent / target.partition("#")[0]).resolve()
    generated = path.is_relative_to(DOCS) and path.relative_to(DOCS).parts[:1] and path.relative_to(DOCS).parts[0]
    if generated not in GENERATED and not path.exists():
        raise FileNotFoundError(f"{origin.relative_to(ROOT)} links to {target}, which does not exist")
    return path


def _needs_page(path: Path) -> bool:
    """Tell whether the site shows ``path`` only if a page is made for it here."""
    if path.is_relative_to(DOCS):
        return path.is_dir() or path.suffix == ".py"
    return path.suffix not in PICTURES and folder_of(path) is None


def _page_of(path: Path) -> Path:
    """Return the site's page for a file or a folder."""
    if api := folder_of(path):
        return DOCS / "api" / f"{api}.rst"
    if path.is_relative_to(DOCS) and not _needs_page(path):
        return path
    relative = path.relative_to(ROOT)
    return DOCS / FOLDER / (relative if path.suffix == ".md" else relative.with_name(f"{relative.name}.md"))


def _text(path: Path) -> str:
    head = "" if path in ALWAYS else "---\norphan: true\n---\n\n"
    if path.suffix == ".md":
        return head + relinked(CARD_DATA.sub("", path.read_text()), path, _page_of(path))
    head += f"# {path.relative_to(ROOT)}\n\n"
    return head + ("\n".join(map(_item, _children(path))) if path.is_dir() else _listing(path)) + "\n"


def _listing(path: Path) -> str:
    language = LANGUAGES.get(path.suffix, "text")
    return f"```{{literalinclude}} {os.path.relpath(path, _page_of(path).parent)}\n:language: {language}\n```"


def _children(folder: Path) -> list[Path]:
    """Return what a folder's page lists: folders, pictures and files of a known language."""
    shown = {".md", *LANGUAGES, *PICTURES}
    return sorted(
        path
        for path in folder.iterdir()
        if (path.is_dir() or path.suffix in shown) and not path.name.startswith((".", "__"))
    )


def _item(path: Path) -> str:
    place = _page_of(path.parent).parent
    if path.suffix in PICTURES:
        return f"![{path.stem}]({os.path.relpath(path, place)})"
    return f"- [{path.name}]({os.path.relpath(_page_of(path), place)})"


def _relink(app: Sphinx, docname: str, source: list[str]) -> None:
    path = Path(app.srcdir) / f"{docname}.md"
    if _is_written(path):
        source[0] = relinked(source[0], path, path)


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages when a build begins, and let the links of the others lead to them."""
    app.connect("builder-inited", lambda app: write_pages(Path(app.srcdir), FOLDER, pages()))
    app.connect("source-read", _relink)
    return {"parallel_read_safe": True}
