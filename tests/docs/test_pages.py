"""Everything that the pages point at is there: files, headings, classes, modules, images, commands,
options.
"""

import argparse
import ast
import functools
import importlib
import re
from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import COMMANDS
from dynahoi_lerobot.core.arguments import add_options
from dynahoi_lerobot.core.registry import GROUP
from tests.docs.documents import ROOT, Page, pages

PAGES = pytest.mark.parametrize(
    "page", pages(), ids=lambda page: page.path.relative_to(ROOT).as_posix()
)
DOTTED = re.compile(
    r"((?:dynahoi_lerobot|lerobot_policy_\w+|lerobot_env_\w+)(?:\.\w+)+)(?::(\w+))?"
)
LARGEST_BYTES = 400_000


@PAGES
def test_every_link_path_name_and_module_is_there(page: Page):
    assert not [target for _, target in page.links if not _leads_somewhere(page, target)]
    assert not sorted(path for path in page.paths if not (ROOT / path).exists())
    assert not [
        f"{text} in {target}"
        for text, target in page.links
        if target.endswith(".py")
        and re.fullmatch(r"`[A-Za-z_][\w.]*`", text)
        and not text.endswith(".py`")
        if not set(text.strip("`").split(".")) <= _defined(page.path.parent / target)
    ]
    for module, name in {
        match.groups() for span in {*page.spans} - {GROUP} if (match := DOTTED.fullmatch(span))
    }:
        assert name is None or hasattr(importlib.import_module(module), name), (
            f"{module} has no {name}"
        )
        importlib.import_module(module)


def test_every_image_is_small_and_shown():
    shown = {(page.path.parent / target).resolve() for page in pages() for _, target in page.links}
    images = sorted((ROOT / "docs" / "images").iterdir())
    assert images
    assert not [
        image.name for image in images if image not in shown or image.stat().st_size > LARGEST_BYTES
    ]


def _leads_somewhere(page: Page, target: str) -> bool:
    name, _, anchor = target.partition("#")
    path = (page.path.parent / name).resolve() if name else page.path
    return path.exists() and (not anchor or anchor in Page.read(path).anchors)


def _defined(path: Path) -> set[str]:
    """Return the names of all classes, functions and variables of a module."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    named = {node.name for node in nodes if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    return named | {
        node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


HEADER = re.compile(r"^#\s+(dynahoi .*)$", re.MULTILINE)
IN_PAGES = {tuple(words) for page in pages() for words in page.commands if words[0] == "dynahoi"}
RECIPES = [path.read_text() for path in (ROOT / "recipes").rglob("*.yaml")]
IN_RECIPES = {tuple(line.split()) for text in RECIPES for line in HEADER.findall(text)}
ELSEWHERE = {"--cpu", "--multi_gpu", "--steps"}
"""Options of other programs that look like ours."""


@functools.cache
def options(command: str) -> frozenset[str]:
    parser = argparse.ArgumentParser()
    add_options(parser, importlib.import_module(COMMANDS[command][0]).Options)
    return frozenset(parser._option_string_actions)


def test_commands_have_the_options_shown():
    assert len(IN_PAGES) > 30
    assert len(IN_RECIPES) > 10
    for words in IN_PAGES | IN_RECIPES:
        assert words[1] in COMMANDS, words
        shown = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert shown <= options(words[1]), words


@PAGES
def test_options_named_in_the_text_exist_in_some_command(page: Page):
    known = frozenset().union(*map(options, COMMANDS))
    named = {span.split("=")[0].split()[0] for span in page.spans if span.startswith("--")}
    ours = {option for option in named if "." not in option and "_" not in option}
    assert not ours - known - ELSEWHERE
