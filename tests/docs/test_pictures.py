"""Every picture that is kept as a file is small, is shown by a page, and is made by a command that a page names."""

from __future__ import annotations

import re
from fnmatch import fnmatch
from pathlib import Path

import pytest

from docs.extensions.repository_files import DOCS, PICTURES
from tests.docs.documents import ROOT, Page, pages

LARGEST_BYTES = 300_000
FOLDERS = (DOCS, DOCS / "contact")
FILES = sorted(path for folder in FOLDERS for path in folder.iterdir() if path.suffix in PICTURES)
MADE = re.search(r"## Pictures of the documentation\n.*?(?=\n## )", (ROOT / "CONTRIBUTING.md").read_text(), re.DOTALL)


def shown(page: Page) -> set[Path]:
    """Return what the page's links and pictures lead to."""
    return {(page.path.parent / target).resolve() for _, target in page.links}


@pytest.mark.parametrize("picture", FILES, ids=lambda path: path.relative_to(DOCS).as_posix())
def test_a_picture_is_small_shown_and_made_by_a_command(picture: Path):
    assert picture.stat().st_size <= LARGEST_BYTES
    assert [page.path for page in pages() if picture in shown(page)]
    assert MADE
    names = re.findall(r"[\w*]+\.(?:gif|png|jpg|svg)", MADE.group())
    assert any(fnmatch(picture.name, name) for name in names), f"which command of CONTRIBUTING.md makes {picture.name}?"


def test_no_command_makes_a_picture_that_is_not_there():
    assert MADE
    names = re.findall(r"[\w*]+\.(?:gif|png|jpg|svg)", MADE.group())
    assert not [name for name in names if not any(fnmatch(path.name, name) for path in FILES)]
