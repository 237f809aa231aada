"""Everything that the pages point at is there: files, headings, classes, modules; and prose fits a screen."""

from __future__ import annotations

import ast
import functools
import importlib
import re
from pathlib import Path

import pytest

from docs.extensions import api_pages, notebook_pages
from docs.extensions.gallery import pages as gallery
from docs.extensions.repository_files import GENERATED, PICTURES
from dynahoi_lerobot.foundation.plugins import GROUP
from tests.docs.documents import ROOT, Page, pages

PAGES = pytest.mark.parametrize("page", pages(), ids=lambda page: page.path.relative_to(ROOT).as_posix())
DOTTED = re.compile(r"((?:dynahoi_lerobot|lerobot_policy_\w+|lerobot_env_\w+)(?:\.\w+)+)(?::(\w+))?")
WIDEST = 120


@PAGES
def test_every_link_leads_to_a_file_and_heading(page: Page):
    broken = [target for _, target in page.links if not _leads_somewhere(page, target)]
    assert not broken


@PAGES
def test_every_path_named_exists(page: Page):
    assert not sorted(path for path in page.paths if not (ROOT / path).exists())


@PAGES
def test_every_name_that_links_to_a_source_file_is_defined_there(page: Page):
    missing = [
        f"{text} in {target}"
        for text, target in page.links
        if target.endswith(".py") and re.fullmatch(r"`[A-Za-z_][\w.]*`", text) and not text.endswith(".py`")
        if not set(text.strip("`").split(".")) <= _defined(page.path.parent / target)
    ]
    assert not missing


@PAGES
def test_every_module_named_can_be_imported(page: Page):
    for module, name in {match.groups() for span in {*page.spans} - {GROUP} if (match := DOTTED.fullmatch(span))}:
        assert name is None or hasattr(importlib.import_module(module), name), f"{module} has no {name}"
        importlib.import_module(module)


@PAGES
def test_prose_is_at_most_120_characters_wide(page: Page):
    lines = [line for line in page.prose.splitlines() if not line.startswith(("|", "![", "  ["))]
    assert not [line for line in lines if len(line) > WIDEST]


def _leads_somewhere(page: Page, target: str) -> bool:
    name, _, anchor = target.partition("#")
    path = (page.path.parent / name).resolve() if name else page.path
    if (below := _below_docs(path)).partition("/")[0] in GENERATED:
        return path.suffix in PICTURES or below in _generated()  # pictures are drawn, and looked for, by the build
    return path.exists() and (not anchor or anchor in Page.read(path).anchors)


def _below_docs(path: Path) -> str:
    return path.relative_to(ROOT / "docs").as_posix() if path.is_relative_to(ROOT / "docs") else ""


@functools.cache
def _generated() -> set[str]:
    return {*gallery.pages(), *api_pages.pages(), *notebook_pages.pages()}


def _defined(path: Path) -> set[str]:
    """Return the names of all classes, functions and variables of a module."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    named = {node.name for node in nodes if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    return named | {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
