"""Registries of classes by name: a new class is one new file with a registering decorator."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable
from types import ModuleType
from typing import Any, cast


class Registry[T: type]:
    """Classes by name, each registered where it is defined.

    Args:
        kind: what the classes are, for error messages (``"backbone"``).
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._classes: dict[str, T] = {}

    def register[C: type](self, name: str) -> Callable[[C], C]:
        """Return a class decorator that registers the class as ``name``.

        Raises:
            ValueError: if another class already has the name.
        """

        def decorate(cls: C) -> C:
            if name in self._classes:
                raise ValueError(f"{self.kind} '{name}' is registered twice: {self._classes[name]} and {cls}.")
            self._classes[name] = cast(T, cls)
            return cls

        return decorate

    def names(self) -> list[str]:
        """Return the known names, sorted."""
        return sorted(self._classes)

    def build(self, name: str, *args: Any, options: dict[str, Any] | None = None) -> Any:
        """Construct the class called ``name`` with positional ``args`` and keyword ``options``.

        Raises:
            ValueError: if the name, or one of the options, is unknown.
        """
        if name not in self._classes:
            raise ValueError(f"unknown {self.kind} '{name}': choose one of {', '.join(self.names())}.")
        cls, options = self._classes[name], options or {}
        allowed = list(inspect.signature(cls).parameters)[len(args) :]
        if unknown := sorted(set(options) - set(allowed)):
            raise ValueError(f"{self.kind} '{name}' has no option {unknown[0]!r}: it takes {', '.join(allowed)}.")
        return cls(*args, **options)


def import_siblings(package: ModuleType) -> None:
    """Import every module of ``package``, so that each registers what it defines."""
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
