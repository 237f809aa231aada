"""Commands and options of ``dynahoi`` that the prose names, and those in headers of recipes, exist."""

from __future__ import annotations

import argparse
import functools
import importlib
import re

import pytest

from dynahoi_lerobot.cli.main import COMMANDS
from tests.docs.documents import ROOT, Page, pages

HEADER = re.compile(r"^#\s+(dynahoi .*)$", re.MULTILINE)
IN_PAGES = {tuple(words) for page in pages() for words in page.commands if words[0] == "dynahoi"}
RECIPES = [path.read_text() for path in (ROOT / "recipes").rglob("*.yaml")]
IN_RECIPES = {tuple(line.split()) for text in RECIPES for line in HEADER.findall(text)}
ELSEWHERE = {"--cpu", "--multi_gpu", "--steps"}
"""Options of other programs that look like ours."""


@functools.cache
def options(command: str) -> frozenset[str]:
    parser = argparse.ArgumentParser()
    importlib.import_module(COMMANDS[command][0]).add_arguments(parser)
    return frozenset(parser._option_string_actions)


def test_commands_have_the_options_shown():
    assert len(IN_PAGES) > 30
    assert len(IN_RECIPES) > 10
    for words in IN_PAGES | IN_RECIPES:
        assert words[1] in COMMANDS, words
        shown = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert shown <= options(words[1]), words


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.path.name)
def test_options_named_in_the_text_exist_in_some_command(page: Page):
    known = frozenset().union(*map(options, COMMANDS))
    named = {span.split("=")[0].split()[0] for span in page.spans if span.startswith("--")}
    ours = {option for option in named if "." not in option and "_" not in option}
    assert not ours - known - ELSEWHERE
