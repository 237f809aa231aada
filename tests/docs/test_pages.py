"""Everything that the pages name is there: files, images, commands, options."""

import argparse
import functools
import importlib
import re

import pytest

from dynahoi_lerobot.cli.main import COMMANDS
from dynahoi_lerobot.core.arguments import add_options
from tests.docs.documents import ROOT, Page, pages

PAGES = pages()
every_page = pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: page.path.relative_to(ROOT).as_posix()
)
FILE = re.compile(
    r"(benchmarks|checkpoints|docs|dynahoi_lerobot|envs|policies|recipes|tests|\.ci)/[\w./-]+"
)
CREATED = "dynahoi_lerobot/motions/spiral.py"
"""What the reader creates."""
LARGEST_BYTES = 400_000


@every_page
def test_every_path_is_there(page: Page):
    """Links and anchors are checked by the documentation's build."""
    paths = {span for span in page.spans if FILE.fullmatch(span)} - {CREATED}
    assert not [path for path in paths if not (ROOT / path).exists()]


def test_every_image_is_small_and_shown():
    text = "".join(page.path.read_text() for page in PAGES)
    for image in (ROOT / "docs" / "images").iterdir():
        assert f"images/{image.name})" in text
        assert image.stat().st_size <= LARGEST_BYTES, image.name


@functools.cache
def options(command: str) -> frozenset[str]:
    parser = argparse.ArgumentParser()
    add_options(parser, importlib.import_module(COMMANDS[command][0]).Options)
    return frozenset(parser._option_string_actions)


def test_commands_have_the_options_shown():
    headers = "".join(path.read_text() for path in (ROOT / "recipes").rglob("*.yaml"))
    shown = [line.split() for line in re.findall(r"^#\s+(dynahoi .*)$", headers, re.MULTILINE)]
    assert len(shown) > 10
    shown += [words for page in PAGES for words in page.commands if words[0] == "dynahoi"]
    for _, command, *words in shown:
        given = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert given <= options(command), (command, words)


OF_OTHERS = {"--cpu", "--multi_gpu", "--steps"}
"""Options of other programs that look like ours."""


@every_page
def test_options_named_in_the_text_exist_in_some_command(page: Page):
    ours = {span for span in page.spans if re.match(r"--[a-z-]+($|[= ])", span)}
    named = {re.split("[= ]", span)[0] for span in ours}
    assert named <= OF_OTHERS.union(*map(options, COMMANDS))
