"""The rooms of the core, in the order in which they may import each other: each knows only those before it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import dynahoi_lerobot

PACKAGE = Path(dynahoi_lerobot.__file__).parent

ROOMS = (
    "core",
    "objects",
    "motions",
    "hands",
    "metrics",
    "scene",
    "renderers",
    "captures",
    "experts",
    "sampling",
    "world",
    "rollout",
    "env",
    "dataset",
    "verify",
    "vlm",
    "evaluate",
    "generate",
    "pretrain",
    "hub",
    "report",
    "doctor",
    "cli",
)
"""Folders and modules of the package."""


def room_of(module: str) -> str:
    """Return the room of a dotted module of ``dynahoi_lerobot``."""
    return module.split(".")[1]


def imports() -> Iterator[tuple[str, str]]:
    """Yield (importing, imported) module of every import within the core.

    Imports inside functions count, and so do modules that are imported by name, as the commands are. Imports for type
    checkers alone do not.
    """
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
        for node in _run_time_nodes(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                yield module, node.module
            elif isinstance(node, ast.Import):
                yield from ((module, alias.name) for alias in node.names)
            elif isinstance(node, ast.Constant) and _is_module(node.value):
                yield module, str(node.value)


def _run_time_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes of a module that are not below ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            yield node
            yield from _run_time_nodes(node)


def _is_module(value: object) -> bool:
    """Tell whether a constant is the dotted name of a module of the core."""
    if not isinstance(value, str) or not re.fullmatch(rf"{PACKAGE.name}(\.\w+)+", value):
        return False
    path = PACKAGE.parent.joinpath(*value.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()
