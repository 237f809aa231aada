"""One registry for every family that a user may add to: motions, objects, metrics, renderers.

Other distributions may register as well, by *plugins*: modules that entry points name. In the
``pyproject.toml`` of such a distribution::

    [project.entry-points."dynahoi_lerobot.plugins"]
    spiral = "my_package.spiral"
"""

import difflib
import importlib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import cast


def known[T](noun: str, name: str, table: Mapping[str, T]) -> T:
    """Return the entry called ``name`` of a table.

    Raises:
        ValueError: if there is none; it suggests a name that is nearly the same and lists
            all.
    """
    if name not in table:
        raise ValueError(
            f"unknown {noun} {name!r}{suggestion(name, table)}; "
            f"known: {', '.join(filter(None, table))}"
        )
    return table[name]


def refuse_repeated(noun: str, names: Sequence[str]) -> None:
    """Raise a ValueError if a name is listed more than once."""
    if len(set(names)) < len(names):
        raise ValueError(f"each {noun} may be named once, got {', '.join(names)}")


def suggestion(name: str, names: Iterable[str]) -> str:
    """Return `` (did you mean '...'?)`` with the closest of ``names``, or nothing if none is."""
    close = difflib.get_close_matches(name, list(names), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


class Registry[T]:
    """Names to things, filled by decorators.

    Each package of the core imports its own modules, so that importing the package registers all of
    them. A module of another distribution registers when it is imported: by its user, or, if an
    entry point names it, when a name is first looked up here.
    """

    def __init__(
        self,
        noun: str,
        base: type,
        *,
        needs: Sequence[str] = (),
        slow: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        """Create an empty registry.

        Args:
            noun: names an entry in error messages.
            base: what every entry is an instance or a subclass of.
            needs: attributes that every entry defines.
            slow: modules by the name that each registers, which are imported when that name is
                looked up, because the import takes long.
        """
        self.noun = noun
        self._base = base
        self._needs = needs
        self._slow = slow
        self._entries: dict[str, T] = {}

    def register[E](self, name: str) -> Callable[[E], E]:
        """Return a decorator that files the decorated object under ``name``; a class gets it as its
        ``name``.

        Raises:
            ValueError: if another object already has the name, or the object is not what the
                registry holds.
        """

        def decorate(entry: E) -> E:
            self._check_kind(name, entry)
            taken = self._taken(name, entry)
            if taken is not None:
                raise ValueError(
                    f"the {self.noun} name {name!r} is taken by {taken!r}; choose another for "
                    f"{entry!r}"
                )
            if isinstance(entry, type):
                entry.name = name  # type: ignore[attr-defined]
            self._entries[name] = cast(T, entry)
            return entry

        return decorate

    def _check_kind(self, name: str, entry: object) -> None:
        fits = issubclass if isinstance(entry, type) else isinstance
        if not fits(entry, self._base):  # type: ignore[arg-type]
            raise ValueError(
                f"{self.noun} {name!r} must be of type {self._base.__name__}, got {entry!r}"
            )
        missing = [attribute for attribute in self._needs if not hasattr(entry, attribute)]
        if missing:
            raise ValueError(f"{self.noun} {name!r} must define {missing[0]}; {entry!r} does not")

    def _taken(self, name: str, entry: object) -> object:
        """Return what else has ``name``; None if nothing has. A reloaded module takes its own."""
        module = self._slow.get(name)
        if module not in (None, entry.__module__):
            return module
        taken = self._entries.get(name)
        same = getattr(taken, "__qualname__", taken) == getattr(entry, "__qualname__", entry)
        return None if same else taken

    def names(self) -> list[str]:
        """Return all registered names, sorted."""
        load_plugins()
        return sorted({*self._entries, *self._slow})

    def __getitem__(self, name: str) -> T:
        """Return the entry called ``name``; ValueError if nothing is registered under it."""
        if name not in self._entries:
            self.check(name)
            if name in self._slow:
                importlib.import_module(self._slow[name])
        return self._entries[name]

    def check(self, name: str) -> None:
        """Refuse a name that nothing is registered under, without importing what is.

        Raises:
            ValueError: naming the registered ones.
        """
        known(self.noun, name, dict.fromkeys(self.names()))

    def __contains__(self, name: object) -> bool:
        """Tell whether something is registered under ``name``."""
        return name in self.names()

    def items(self) -> Iterator[tuple[str, T]]:
        """Yield ``(name, entry)`` in the order of the names."""
        for name in self.names():
            yield name, self[name]


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
        from dynahoi_lerobot.core.reading import LeftOut

        source = f" of {entry.dist.name}" if entry.dist else ""
        problem = f"{type(error).__name__}: {error}"
        warnings.warn(
            f"the plugin {entry.name!r}{source} ({entry.value}) could not be imported: {problem}",
            LeftOut,
            stacklevel=2,
        )
