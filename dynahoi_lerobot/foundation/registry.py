"""One registry for every family that a user may add to: motions, objects, metrics, renderers."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from collections.abc import Callable, Iterator
from typing import cast

from dynahoi_lerobot.foundation.plugins import load_plugins


class UnknownNameError(ValueError):
    """A name that nothing registers; the message lists the registered ones."""


class Registry[T]:
    """Names to things, filled by decorators in one module, or in the modules of one package.

    They are imported on first look-up, so a new kind is one class or function and no other line. Code outside the
    package may register too: importing the module that holds the decorator is enough, and the modules that other
    distributions name as ``plugins`` are imported on first look-up as well.
    """

    def __init__(self, noun: str, package: str) -> None:
        """Name what is registered (for error messages) and the module or package that registers it."""
        self.noun = noun
        self._package = package
        self._entries: dict[str, T] = {}
        self._discovered = False

    def register[E](self, name: str) -> Callable[[E], E]:
        """Return a decorator that files the decorated object under ``name``.

        Raises:
            ValueError: if another object already has the name.
        """

        def decorate(entry: E) -> E:
            taken = self._entries.get(name)
            if taken is not None and getattr(taken, "__qualname__", taken) != getattr(entry, "__qualname__", entry):
                raise ValueError(f"the {self.noun} name {name!r} is taken by {taken!r}; choose another for {entry!r}")
            self._entries[name] = cast(T, entry)
            return entry

        return decorate

    def names(self) -> list[str]:
        """Return all registered names, sorted."""
        self._discover()
        return sorted(self._entries)

    def __getitem__(self, name: str) -> T:
        """Return the entry called ``name``.

        Raises:
            UnknownNameError: if nothing is registered under it.
        """
        self._discover()
        if name not in self._entries:
            close = difflib.get_close_matches(name, self._entries, n=1)
            hint = f" (did you mean {close[0]!r}?)" if close else ""
            raise UnknownNameError(f"unknown {self.noun} {name!r}{hint}; known: {', '.join(self.names())}")
        return self._entries[name]

    def __contains__(self, name: object) -> bool:
        """Tell whether something is registered under ``name``."""
        self._discover()
        return name in self._entries

    def items(self) -> Iterator[tuple[str, T]]:
        """Yield ``(name, entry)`` in the order of the names."""
        for name in self.names():
            yield name, self._entries[name]

    def _discover(self) -> None:
        if self._discovered:
            return
        self._discovered = True
        package = importlib.import_module(self._package)
        for module in pkgutil.iter_modules(getattr(package, "__path__", ())):
            if module.name != "base":
                importlib.import_module(f"{self._package}.{module.name}")
        load_plugins()
