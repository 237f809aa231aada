"""Pages that are written before a build and are not committed."""

from __future__ import annotations

from pathlib import Path


def write_pages(source: Path, folder: str, pages: dict[str, str]) -> None:
    """Make ``folder`` below ``source`` hold exactly ``pages``; what has not changed is left alone, for fast builds.

    Args:
        source: the documentation's source folder.
        folder: one that holds nothing but generated pages.
        pages: text by path below ``source``; the path begins with ``folder``.
    """
    for path in (source / folder).rglob("*"):
        if path.suffix in (".md", ".rst") and path.relative_to(source).as_posix() not in pages:
            path.unlink()
    for name, text in pages.items():
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_text() != text:
            path.write_text(text)
