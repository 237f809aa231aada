"""Which tests hold a registered class to its theory: found in the tests' sources, so that no list has to be kept."""

from __future__ import annotations

import ast
import functools
from pathlib import Path

ROOT = Path(__file__).parents[3]


def named_tests(room: str, words: set[str]) -> dict[Path, list[str]]:
    """Return the tests in ``tests/<room>`` that mention one of ``words``, by file; those of every entry are left out.

    Args:
        room: name of the folder.
        words: names of classes, of functions or in quotes. A test mentions what its helpers mention, too.
    """
    paths = set((ROOT / "tests" / room).glob("test_*.py")) - set(sweeping_tests(room))
    found = {path: _tests(path, words) for path in sorted(paths)}
    return {path: names for path, names in found.items() if names}


def sweeping_tests(room: str) -> dict[Path, list[str]]:
    """Return the tests in ``tests/<room>`` that run for every registered entry, by file."""
    names = ("test_any_*.py", "test_registry.py", f"test_{room.removesuffix('s')}.py")
    return {path: _tests(path) for name in names for path in (ROOT / "tests" / room).glob(name)}


def sentence(test: str) -> str:
    """Return the name of a test as words."""
    return test.removeprefix("test_").replace("_", " ")


def _tests(path: Path, words: set[str] | None = None) -> list[str]:
    """Return the tests in a file, or those that mention one of ``words`` directly or through what they use."""
    mentions = _mentions_by_definition(path)
    reached = {name for name, said in mentions.items() if words is None or said & words}
    while more := {name for name, said in mentions.items() if said & reached} - reached:
        reached |= more
    return [name for name in mentions if name in reached and name.startswith("test_")]


@functools.cache
def _mentions_by_definition(path: Path) -> dict[str, set[str]]:
    return {name: _mentions(node) for node in ast.parse(path.read_text()).body for name in _defined(node)}


def _defined(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


def _mentions(node: ast.stmt) -> set[str]:
    """Return the names that a definition uses, and its strings."""
    names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
    return names | {
        part.value for part in ast.walk(node) if isinstance(part, ast.Constant) and isinstance(part.value, str)
    }
