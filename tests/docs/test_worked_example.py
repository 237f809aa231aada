"""The worked example of docs/extend.md, in a copy of the checkout: a motion that a contributor
adds.
"""

import re
import shutil
from pathlib import Path

import pytest

from tests.docs.documents import ROOT, Page
from tests.tools import python

EXAMPLE = Page.read(ROOT / "docs" / "extend.md")
MODULES = {"dynahoi": "dynahoi_lerobot.cli.main", "pytest": "pytest"}
"""What Python runs for the programs of the example."""


@pytest.mark.slow
def test_the_worked_example_works_as_written(tmp_path: Path):
    (source,) = (block.body for block in EXAMPLE.blocks if block.file == "spiral.py")
    for part in ("dynahoi_lerobot", "tests"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    path = "dynahoi_lerobot/motions/spiral.py"
    package = "dynahoi_lerobot/motions/__init__.py"
    (tmp_path / path).write_text(source)
    modules = (tmp_path / package).read_text()
    (tmp_path / package).write_text(modules.replace("    straight", "    spiral,\n    straight", 1))
    commands = [words for words in EXAMPLE.commands if "spiral" in " ".join(words)]
    assert [program for program, *_ in commands] == ["dynahoi", "pytest", "dynahoi", "dynahoi"]
    said = [python("-m", MODULES[name], *words, cwd=tmp_path) for name, *words in commands]
    assert re.search(r"[1-9]\d* passed", said[1])
    assert (tmp_path / "spiral.gif").read_bytes()[:4] == b"GIF8"
