"""The code fingerprint: a hash of the sources and library versions that decide the bytes of a
dataset.
"""

import hashlib
import importlib.util
import platform
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import dynahoi_lerobot
from dynahoi_lerobot.core.registry import plugin_packages
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.sampling.recipe import Recipe

LIBRARIES = (
    "numpy",
    "mujoco",
    "mujoco-warp",
    "warp-lang",
    "av",
    "pyarrow",
    "opencv-python-headless",
)
"""Libraries whose versions may change states, pixels or files."""

DECIDING = (
    "core",
    "objects",
    "motions",
    "hands",
    "scene",
    "renderers",
    "experts",
    "world",
    "sampling",
    "rollout",
    "dataset",
)
"""Packages that decide a dataset's contents; all others read datasets, play policies or spread
work."""
DECIDING_MODULES = ("__init__.py", "captures.py", "rules.py", "generate/plan.py")
"""Modules outside them that do, too."""


@cache
def code_fingerprint() -> str:
    """Return 16 hexadecimal digits that change with the deciding sources, library versions and
    processor kind.

    Installed plugins count with every module of their packages: what they register may be drawn or
    change what is.
    """
    digest = hashlib.sha256(hash_sources(Path(dynahoi_lerobot.__file__).parent))
    digest.update(hash_packages(plugin_packages()))
    for name, which in surroundings().items():
        digest.update(f"{name}={which}".encode())
    return digest.hexdigest()[:16]


def recipe_code(recipe: Recipe) -> str:
    """Return ``code_fingerprint``, with the modules of motions and objects that a recipe names and
    that belong to no installed plugin.
    """
    named = [
        *(MOTIONS[name] for name in recipe.motions),
        *(OBJECTS[name] for name in recipe.objects),
    ]
    extension = extension_fingerprint(named)
    if not extension:
        return code_fingerprint()
    return hashlib.sha256((code_fingerprint() + extension).encode()).hexdigest()[:16]


def surroundings() -> dict[str, str]:
    """Return what beside the sources is in the code fingerprint: the kind of processor, and
    versions by library.
    """
    return {
        "processor": platform.machine(),
        **{name: installed_version(name) or "absent" for name in LIBRARIES},
    }


def extension_fingerprint(entries: Iterable[object]) -> str:
    """Return hashes of the files that define some of ``entries`` and that ``code_fingerprint``
    leaves out, those of neither this package nor a plugin; empty if there are none.
    """
    counted = {"dynahoi_lerobot", *plugin_packages()}
    modules = {entry.__module__ for entry in entries}
    return "".join(
        _module_hash(module) for module in sorted(modules) if module.split(".")[0] not in counted
    )


@cache
def _module_hash(module: str) -> str:
    path = getattr(sys.modules[module], "__file__", None)  # none for classes typed into a console
    source = Path(path).read_bytes() if path else b""
    return hashlib.sha256(module.encode() + source).hexdigest()[:16]


def deciding_sources(package: Path) -> list[Path]:
    """Return the deciding sources below ``package``."""
    in_rooms = [path for room in DECIDING for path in (package / room).rglob("*.py")]
    return sorted([*in_rooms, *(package / module for module in DECIDING_MODULES)])


def hash_sources(package: Path) -> bytes:
    """Return the sha256 of the names and contents of the deciding sources below ``package``."""
    return _hash((path.relative_to(package).as_posix(), path) for path in deciding_sources(package))


def hash_packages(names: Iterable[str]) -> bytes:
    """Return the sha256 of the names and contents of the modules of top-level packages; those not
    found are none.
    """
    paths: set[Path] = set()
    for name in names:
        spec = importlib.util.find_spec(name)
        if spec and spec.submodule_search_locations:
            for folder in spec.submodule_search_locations:
                paths.update(Path(folder).rglob("*.py"))
        elif spec and spec.origin:
            paths.add(Path(spec.origin))  # a module that is no package
    return _hash((path.name, path) for path in sorted(paths))


def _hash(files: Iterable[tuple[str, Path]]) -> bytes:
    digest = hashlib.sha256()
    for name, path in files:
        digest.update(name.encode())
        digest.update(path.read_bytes())
    return digest.digest()


@cache
def installed_version(name: str) -> str | None:
    """Return the version of an installed distribution; None if there is none of that name."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None
