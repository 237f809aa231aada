"""One registry for every family that a user may add to: motions, objects, metrics, renderers.

Other distributions may register as well, by *plugins*: modules that entry points name. In the ``pyproject.toml`` of
such a distribution::

    [project.entry-points."dynahoi_lerobot.plugins"]
    spiral = "my_package.spiral"
"""

import difflib
import importlib
import pkgutil
import warnings
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import cast


class UnknownNameError(ValueError):
    """A name that nothing registers; the message lists the registered ones."""


def known[T](noun: str, name: str, table: Mapping[str, T]) -> T:
    """Return the entry called ``name`` of a table.

    Raises:
        UnknownNameError: if there is none; it suggests a name that is nearly the same and lists all.
    """
    if name not in table:
        close = difflib.get_close_matches(name, table, n=1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise UnknownNameError(f"unknown {noun} {name!r}{hint}; known: {', '.join(table)}")
    return table[name]


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
        """Return a decorator that files the decorated object under ``name``; a class gets it as its ``name``.

        Raises:
            ValueError: if another object already has the name.
        """

        def decorate(entry: E) -> E:
            taken = self._entries.get(name)
            if taken is not None and getattr(taken, "__qualname__", taken) != getattr(entry, "__qualname__", entry):
                raise ValueError(f"the {self.noun} name {name!r} is taken by {taken!r}; choose another for {entry!r}")
            if isinstance(entry, type):
                entry.name = name  # type: ignore[attr-defined]
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
        return known(self.noun, name, dict(self.items()))

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


GROUP = "dynahoi_lerobot.plugins"

_loaded = False


def plugin_packages() -> set[str]:
    """Return the top-level packages that the entry points in ``GROUP`` name, whether they can be imported or not."""
    return {entry.module.partition(".")[0] for entry in entry_points(group=GROUP)}


def load_plugins() -> None:
    """Import the module of every entry point in ``GROUP``, once in a process; one that fails is named in a warning."""
    global _loaded  # noqa: PLW0603 - a module that is being imported may look names up, which leads here again
    if _loaded:
        return
    _loaded = True
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value)):
        import_plugin(entry)


def import_plugin(entry: EntryPoint) -> None:
    """Import a plugin's module; one that fails is named in a warning."""
    try:
        entry.load()
    except Exception as error:  # whatever a stranger's module raises
        source = f" of {entry.dist.name}" if entry.dist else ""
        problem = f"{type(error).__name__}: {error}"
        warnings.warn(
            f"the plugin {entry.name!r}{source} ({entry.value}) could not be imported: {problem}",
            RuntimeWarning,
            stacklevel=2,
        )
