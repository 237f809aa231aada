"""Every block of code in the pages runs as it stands there, with smaller numbers; or it says why it does not."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.docs.documents import ROOT, Page, pages

ORDER = ("generate.md", "train.md", "evaluate.md")
"""Pages whose datasets, checkpoints and results the others use."""
ELSEWHERE = {"CONTRIBUTING.md", "README.md"}
"""Pages whose programs other tests run: tests/docs/test_contributing.py and test_commands.py."""
DATA = {"json": json.loads, "yaml": yaml.safe_load, "toml": tomllib.loads}
PROGRAMS = ("python", "bash")
DRAWN = ("", "text", "{toctree}", "{eval-rst}")
"""Blocks without a language are drawings, or commands whose options are compared with their programs."""


@pytest.fixture
def workspace(tmp_path: Path) -> Iterator[Path]:
    """Let the commands find the repository's folders, in a folder that is empty otherwise."""
    from tests.docs.playing import prepare

    before = Path.cwd()
    prepare(tmp_path)
    yield tmp_path
    os.chdir(before)


def name(page: Page) -> str:
    return page.path.relative_to(ROOT / "docs" if page.path.is_relative_to(ROOT / "docs") else ROOT).as_posix()


def in_order() -> list[Page]:
    return sorted(
        pages(), key=lambda page: (ORDER.index(name(page)) if name(page) in ORDER else len(ORDER), name(page))
    )


@pytest.mark.parametrize("page", pages(), ids=name)
def test_every_block_has_a_language_that_is_tested(page: Page):
    for block in page.all_blocks:
        assert block.language in {*PROGRAMS, *DATA, *DRAWN}, block
        if block.language in DATA:
            assert DATA[block.language](block.body)


@pytest.mark.slow
def test_every_program_and_command_runs(workspace: Path, subtests: pytest.Subtests):
    """One after the other in one folder, because a dataset, a training and an evaluation serve many pages."""
    from tests.docs.playing import play

    played = 0
    for page in in_order():
        for number, block in enumerate(page.all_blocks):
            if name(page) in ELSEWHERE or block.need or not (block.file or block.language in PROGRAMS):
                continue
            with subtests.test(page=name(page), block=number):
                play(block)
                played += 1
    assert played > 20
    assert (workspace / "report.html").is_file()
    assert (workspace / "lob.gif").read_bytes()[:4] == b"GIF8"
