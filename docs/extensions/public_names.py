"""What has a public docstring, read off the sources: the reference must hold all of it."""

from __future__ import annotations

import ast
import importlib
import inspect
from pathlib import Path

from sphinx.ext.napoleon import Config, GoogleDocstring

Definition = ast.ClassDef | ast.FunctionDef


def public_names(module: str, path: Path) -> set[str]:
    """Return the dotted names of the classes, functions and methods of a module that have a public docstring."""
    names = set()
    for node in _definitions(ast.parse(path.read_text())):
        names.add(f"{module}.{node.name}")
        if isinstance(node, ast.ClassDef):
            names |= {f"{module}.{node.name}.{method.name}" for method in _definitions(node)}
    return names


def wrapped_definitions(module: str, path: Path) -> str:
    """Return, in reStructuredText, the functions and classes of a module that a decorator makes something else of.

    Metrics and the ray caster's kernels are such objects; autodoc does not see the docstrings behind them.
    """
    loaded = importlib.import_module(module)
    hidden = [node for node in _definitions(ast.parse(path.read_text())) if _is_wrapped(getattr(loaded, node.name))]
    return "".join(_described(module, node) for node in hidden)


def _definitions(parent: ast.Module | ast.ClassDef) -> list[Definition]:
    found = [node for node in parent.body if isinstance(node, ast.ClassDef | ast.FunctionDef)]
    return [node for node in found if not node.name.startswith("_") and ast.get_docstring(node)]


def _is_wrapped(entry: object) -> bool:
    """Tell whether autodoc would not take an object for the function or the class that it is defined as."""
    return not (inspect.isfunction(entry) or inspect.isclass(entry) or hasattr(entry, "cache_info"))


def _described(module: str, node: Definition) -> str:
    lines = str(GoogleDocstring(ast.get_docstring(node) or "", Config(napoleon_use_ivar=True))).splitlines()
    body = "\n".join(f"   {line}".rstrip() for line in lines)
    return f"\n.. py:{_heading(node)}\n   :module: {module}\n\n{body}\n"


def _heading(node: Definition) -> str:
    if isinstance(node, ast.ClassDef):
        return f"class:: {node.name}"
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"function:: {node.name}({ast.unparse(node.args)}){returns}"
