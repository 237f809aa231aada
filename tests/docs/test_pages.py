"""Everything that the pages name is there: files, modules, images, commands, options."""

import argparse
import functools
import importlib
import re

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
def test_every_path_and_name_is_there(page: Page):
    """Links and anchors are checked by the documentation's build."""
    assert not sorted(path for path in page.paths if not (ROOT / path).exists())
    for span in {*page.spans} - {GROUP}:
        if found := DOTTED.fullmatch(span):
            module = importlib.import_module(found[1])
            assert found[2] is None or hasattr(module, found[2]), span


def test_every_image_is_small_and_shown():
    text = "".join(page.text for page in pages())
    images = sorted((ROOT / "docs" / "images").iterdir())
    assert images
    for image in images:
        assert f"images/{image.name})" in text, image.name
        assert image.stat().st_size <= LARGEST_BYTES, image.name


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
