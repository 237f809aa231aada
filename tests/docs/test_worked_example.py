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
RUN = (
    "import sys; from dynahoi_lerobot.cli.main import main; assert not any(main(x.split()) for "
    "x in sys.argv[1:])"
)
"""Runs commands of ``dynahoi``, each an argument, until one fails."""


@pytest.mark.slow
def test_the_worked_example_works_as_written(tmp_path: Path):
    (source,) = (block.body for block in EXAMPLE.all_blocks if block.file == "spiral.py")
    for part in ("dynahoi_lerobot", "tests"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    path = "dynahoi_lerobot/motions/spiral.py"
    assert f"`{path}`" in EXAMPLE.text
    (tmp_path / path).write_text(source)
    package = tmp_path / path.replace("spiral", "__init__")
    assert f"`{package.relative_to(tmp_path)}`" in EXAMPLE.text
    package.write_text(
        package.read_text().replace("    straight_line,", "    spiral,\n    straight_line,")
    )
    commands = [words for words in EXAMPLE.commands if Path(path).stem in " ".join(words)]
    assert [program for program, *_ in commands] == ["dynahoi", "pytest", "dynahoi", "dynahoi"]
    python(
        "-c",
        RUN,
        *(" ".join(words) for program, *words in commands if program == "dynahoi"),
        cwd=tmp_path,
    )
    said = python("-m", "pytest", "-p", "no:cacheprovider", *commands[1][1:], cwd=tmp_path)
    assert re.search(r"[1-9]\d* passed", said)
    assert (tmp_path / "spiral.gif").read_bytes()[:4] == b"GIF8"
    for check in (["check"], ["format", "--check"]):
        python("-m", "ruff", *check, str(Path(path).parent), cwd=tmp_path)
