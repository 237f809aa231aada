from __future__ import annotations

import ast
import shutil
from pathlib import Path

import pytest

import dynahoi_lerobot
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.sampling.fingerprint import deciding_sources, extension_fingerprint, hash_sources
from tests.rooms import ROOMS

PACKAGE = Path(dynahoi_lerobot.__file__).parent
READING = ("cli", "env", "evaluate", "metrics", "pretrain", "report", "verify", "vlm")
"""Rooms that decide no byte of a dataset; of ``generate`` some modules do."""


@pytest.fixture
def copy(tmp_path) -> Path:
    """A copy of the package's sources, to edit."""
    return shutil.copytree(PACKAGE, tmp_path / "package", ignore=shutil.ignore_patterns("__pycache__"))


def edit(path: Path) -> None:
    assert path.is_file()
    path.write_text(path.read_text() + "\n# edited\n")


@pytest.mark.parametrize("room", [room for room in ROOMS if room not in (*READING, "generate", "hub", "doctor")])
def test_an_edit_in_a_deciding_room_changes_the_fingerprint(copy, room):
    before = hash_sources(copy)
    assert before == hash_sources(PACKAGE)
    sources = [*copy.glob(f"{room}.py"), *(copy / room).rglob("*.py")]
    edit(max(path for path in sources if path.name != "__init__.py"))
    assert hash_sources(copy) != before


@pytest.mark.parametrize("room", [*READING, "generate/executors.py", "hub.py", "doctor.py"])
def test_an_edit_elsewhere_leaves_the_fingerprint(copy, room):
    before = hash_sources(copy)
    place = copy / room
    for path in place.rglob("*.py") if place.is_dir() else [place]:
        edit(path)
    assert hash_sources(copy) == before


def imported(path: Path) -> set[Path]:
    """The package's modules that a file imports, also inside functions; packages count as their ``__init__``."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    below = [PACKAGE.parent / name.replace(".", "/") for name in names if name.startswith("dynahoi_lerobot.")]
    files = {path.with_suffix(".py") for path in below} | {path / "__init__.py" for path in below}
    return {file for file in files if file.is_file()}


def test_deciding_sources_import_only_deciding_sources():
    deciding = set(deciding_sources(PACKAGE))
    assert len(deciding) > 80
    folders = {"generate/__init__.py"}  # empty
    for path in deciding:
        strangers = {found.relative_to(PACKAGE).as_posix() for found in imported(path) - deciding} - folders
        assert not strangers, f"{path.relative_to(PACKAGE)} imports {strangers}"


def test_code_of_others_counts_and_ours_is_not_counted_twice():
    class Theirs:
        pass

    assert extension_fingerprint([OBJECTS["ball"]]) == ""
    assert len(extension_fingerprint([OBJECTS["ball"], Theirs])) == 16
