"""Plugins: modules of other distributions that register motions, objects and so on, named by entry points.

In the ``pyproject.toml`` of such a distribution::

    [project.entry-points."dynahoi_lerobot.plugins"]
    spiral = "my_package.spiral"
"""

from __future__ import annotations

import warnings
from importlib.metadata import EntryPoint, entry_points

GROUP = "dynahoi_lerobot.plugins"

_loaded = False


class PluginWarning(RuntimeWarning):
    """A plugin could not be imported; everything else works without it."""


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
            PluginWarning,
            stacklevel=2,
        )
