"""One registry for every family that a user may add to: motions, objects, metrics, renderers.

Other distributions may register as well, by *plugins*: modules that entry points name. In the
``pyproject.toml`` of such a distribution::

    [project.entry-points."dynahoi_lerobot.plugins"]
    spiral = "my_package.spiral"
"""

import difflib
import importlib
import importlib.util
import pkgutil
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import cast


class UnknownNameError(ValueError):
    """A name that nothing registers; the message lists the registered ones."""


def known[T](noun: str, name: str, table: Mapping[str, T]) -> T:
    """Return the entry called ``name`` of a table.

    Raises:
        UnknownNameError: if there is none; it suggests a name that is nearly the same and lists
            all.
    """
    if name not in table:
        raise UnknownNameError(
            f"unknown {noun} {name!r}{suggestion(name, table)}; "
            f"known: {', '.join(filter(None, table))}"
        )
    return table[name]


def suggestion(name: str, names: Iterable[str]) -> str:
    """Return `` (did you mean '...'?)`` with the closest of ``names``, or nothing if none is."""
    close = difflib.get_close_matches(name, list(names), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


class Registry[T]:
    """Names to things, filled by decorators in one module, or in the modules of one package.

    They are found on first look-up, so a new kind is one class or function and no other line. A
    module whose decorators spell out their names is imported when one of these is looked up, every
    other one at once. Code outside the package may register too: importing the module that holds
    the decorator is enough, and the modules that other distributions name as ``plugins`` are
    imported on first look-up as well.
    """

    def __init__(self, noun: str, package: str) -> None:
        """Name what is registered (for error messages) and the module or package that registers
        it.
        """
        self.noun = noun
        self._package = package
        self._entries: dict[str, T] = {}
        self._modules: dict[str, str] = {}
        self._discovered = False

    def register[E](self, name: str) -> Callable[[E], E]:
        """Return a decorator that files the decorated object under ``name``; a class gets it as its
        ``name``.

        Raises:
            ValueError: if another object already has the name.
        """

        def decorate(entry: E) -> E:
            if self._modules.get(name) not in (None, getattr(entry, "__module__", None)):
                importlib.import_module(self._modules[name])
            taken = self._entries.get(name)
            if taken is not None and getattr(taken, "__qualname__", taken) != getattr(
                entry, "__qualname__", entry
            ):
                raise ValueError(
                    f"the {self.noun} name {name!r} is taken by {taken!r}; choose another for "
                    f"{entry!r}"
                )
            if isinstance(entry, type):
                entry.name = name  # type: ignore[attr-defined]
            self._entries[name] = cast(T, entry)
            return entry

        return decorate

    def names(self) -> list[str]:
        """Return all registered names, sorted."""
        self._discover()
        return sorted({*self._entries, *self._modules})

    def __getitem__(self, name: str) -> T:
        """Return the entry called ``name``; UnknownNameError if nothing is registered under it."""
        if name not in self._entries:
            self.check(name)
            if name in self._modules:
                importlib.import_module(self._modules[name])
        return self._entries[name]

    def check(self, name: str) -> None:
        """Refuse a name that nothing is registered under, without importing what is.

        Raises:
            UnknownNameError: naming those that there are.
        """
        known(self.noun, name, dict.fromkeys(self.names()))

    def __contains__(self, name: object) -> bool:
        """Tell whether something is registered under ``name``."""
        return name in self.names()

    def items(self) -> Iterator[tuple[str, T]]:
        """Yield ``(name, entry)`` in the order of the names."""
        for name in self.names():
            yield name, self[name]

    def _discover(self) -> None:
        if self._discovered:
            return
        self._discovered = True
        package = importlib.import_module(self._package)
        for module in pkgutil.iter_modules(getattr(package, "__path__", ())):
            path = f"{self._package}.{module.name}"
            if names := _spelled_out(path):
                self._modules |= dict.fromkeys(names, path)
            elif module.name != "base":
                importlib.import_module(path)
        load_plugins()


def _spelled_out(module: str) -> list[str]:
    """Return the names that a module's decorators register, or none if one of them computes its
    name.
    """
    spec = importlib.util.find_spec(module)
    source = Path(spec.origin).read_text(encoding="utf-8") if spec and spec.origin else ""
    names = re.findall(r'\.register\("(\w+)"\)', source)
    return names if len(names) == source.count(".register(") else []


GROUP = "dynahoi_lerobot.plugins"

_loaded = False


@cache
def _plugins() -> tuple[EntryPoint, ...]:
    """The entry points in ``GROUP``; to find them, every installed distribution's are read."""
    return tuple(sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value)))


def plugin_packages() -> set[str]:
    """Return the top-level packages that the entry points in ``GROUP`` name, whether they can be
    imported or not.
    """
    return {entry.module.partition(".")[0] for entry in _plugins()}


def load_plugins() -> None:
    """Import the module of every entry point in ``GROUP``, once in a process; one that fails is
    named in a warning.
    """
    global _loaded  # noqa: PLW0603 - a module that is being imported may look names up, which leads here again
    if _loaded:
        return
    _loaded = True
    for entry in _plugins():
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
