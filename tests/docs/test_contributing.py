"""What the table of CONTRIBUTING says a new file must provide, and the worked example of docs/extend.md."""

from __future__ import annotations

import importlib
import inspect
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.documents import ROOT, Page

PAGE = Page.read(ROOT / "CONTRIBUTING.md")
EXAMPLE = Page.read(ROOT / "docs" / "extend.md")
ROWS = re.findall(r"^\| ([\w' -]+) \| `([\w/]+)` \| (decorator )?`(\w+)` \| (.+?) \|", PAGE.text, re.MULTILINE)
CLASSES = [(folder, name, must) for _, folder, decorator, name, must in ROWS if not decorator]
DECORATORS = [(folder, name) for _, folder, decorator, name, _ in ROWS if decorator]
PROGRAMS = {"dynahoi": ["-m", "dynahoi_lerobot.cli.main"], "pytest": ["-m", "pytest", "-p", "no:cacheprovider"]}


def test_the_table_names_every_folder_with_a_registry():
    bases = [*(ROOT / "dynahoi_lerobot").rglob("base.py"), *(ROOT / "policies").glob("*/*/*/base.py")]
    folders = {path.parent.relative_to(ROOT).as_posix() for path in bases if "Registry(" in path.read_text()}
    assert {folder for _, folder, *_ in ROWS} == folders


@pytest.mark.parametrize(("folder", "name", "must"), CLASSES, ids=[name for _, name, _ in CLASSES])
def test_the_table_says_what_a_subclass_must_provide(folder: str, name: str, must: str):
    base = getattr(_base_module(folder), name)
    needed = set(getattr(base, "__abstractmethods__", ())) | _unset_attributes(base)
    if needed:
        assert set(re.findall(r"`(\w+)`", must)) == needed
    else:  # any of several methods; all of them exist
        assert all(hasattr(base, method) for method in re.findall(r"`(\w+)`", must))


@pytest.mark.parametrize(("folder", "name"), DECORATORS)
def test_the_table_names_decorators_that_exist(folder: str, name: str):
    assert inspect.isfunction(getattr(_base_module(folder), name))


@pytest.mark.slow
def test_the_worked_example_works_as_written(tmp_path: Path):
    (source,) = (block.body for block in EXAMPLE.all_blocks if block.file == "spiral.py")
    for part in ("dynahoi_lerobot", "tests"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    path = "dynahoi_lerobot/motions/spiral.py"
    assert f"`{path}`" in EXAMPLE.text
    (tmp_path / path).write_text(source)
    commands = [words for words in EXAMPLE.commands if Path(path).stem in " ".join(words)]
    assert [words[:2] for words in commands] == [
        ["dynahoi", "view"],
        ["pytest", "-n"],
        ["dynahoi", "generate"],
        ["dynahoi", "verify"],
    ]
    for program, *words in commands:
        run = [sys.executable, *PROGRAMS[program], *words]
        done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        if program == "pytest":
            assert re.search(r"[1-9]\d* passed", done.stdout)
    assert (tmp_path / "spiral.gif").read_bytes()[:4] == b"GIF8"
    for check in (["check"], ["format", "--check"]):
        subprocess.run([sys.executable, "-m", "ruff", *check, path], cwd=tmp_path, check=True)


def _base_module(folder: str):
    parts = folder.split("/")
    package = parts if parts[0] == "dynahoi_lerobot" else parts[2:]
    return importlib.import_module(".".join([*package, "base"]))


def _unset_attributes(base: type) -> set[str]:
    """Return the attributes that a class of this project declares and neither it nor its ``__init__`` sets."""
    ours = [cls for cls in base.__mro__ if cls.__module__.startswith(("dynahoi_lerobot", "lerobot_policy_"))]
    return {
        name
        for cls in ours
        for name in inspect.get_annotations(cls)
        if not hasattr(base, name) and name not in _init(cls)
    }


def _init(cls: type) -> str:
    """Return the source of a class's own ``__init__``; empty if it has none."""
    return inspect.getsource(cls.__init__) if "__init__" in vars(cls) else ""
