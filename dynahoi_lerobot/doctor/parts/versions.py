"""Versions of Python and of the libraries, beside what the installed distributions ask for."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from packaging.requirements import Requirement

from dynahoi_lerobot.doctor.parts.base import Fact, part

CORE = "dynahoi_lerobot"
PLUGINS = ("lerobot_env_dynahoi", "lerobot_policy_tracker")
OPTIONAL = {
    "lerobot": "training and LeRobot's commands need it: pip install '.[lerobot]', in a checkout",
    "torch": "comes with lerobot",
}
"""Libraries without which the core works, and what they are for."""
SHOWN = ("mujoco", "mujoco-warp", "warp-lang", "gymnasium", "numpy", *OPTIONAL)


@part("versions")
def versions(folder: Path) -> Iterator[Fact]:
    """Yield the versions of Python, of the distributions and of what they need, and what is out of bounds."""
    del folder
    yield Fact("Python", platform.python_version())
    wanted = _requirements()
    names = [CORE, *PLUGINS, *SHOWN]
    for name in [*names, *sorted(wanted.keys() - set(names))]:
        if (fact := _library(name, wanted.get(name, []))) is not None:
            yield fact


def _requirements() -> dict[str, list[Requirement]]:
    """Return what the installed distributions require, without extras, by name."""
    found: dict[str, list[Requirement]] = {}
    for distribution in (CORE, *PLUGINS):
        if _version(distribution) is None:
            continue
        for requirement in map(Requirement, requires(distribution) or ()):
            if requirement.marker is None or requirement.marker.evaluate():
                found.setdefault(requirement.name, []).append(requirement)
    return found


def _library(name: str, wanted: list[Requirement]) -> Fact | None:
    """Return the fact about a library; None for one that is as it should be and that nobody asks about."""
    found = _version(name)
    bounds = ", ".join(str(requirement.specifier) for requirement in wanted if requirement.specifier)
    if found is None:
        if not wanted:
            return Fact(name, "none", OPTIONAL[name]) if name in OPTIONAL else None
        return Fact(name, "none", f"install it: pip install {str(wanted[0])!r}", problem=True)
    if any(not requirement.specifier.contains(found, prereleases=True) for requirement in wanted):
        return Fact(name, found, f"needs {bounds}: pip install {str(wanted[0])!r}", problem=True)
    return Fact(name, found) if name in (CORE, *PLUGINS, *SHOWN) else None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
