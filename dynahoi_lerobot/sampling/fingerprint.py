"""What code made a dataset: a hash of the sources and library versions that decide its bytes."""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import dynahoi_lerobot

LIBRARIES = ("numpy", "mujoco", "mujoco-warp", "warp-lang", "av", "pyarrow", "pillow")
"""Libraries whose versions may change states, pixels or files."""

DECIDING_SOURCES = (
    "foundation/",
    "objects/",
    "motions/",
    "hands/",
    "scene/",
    "renderers/",
    "captures/",
    "experts/",
    "world/",
    "sampling/",
    "rollout/",
    "dataset/",
    "verify/plausibility.py",
    "generate/pipeline.py",
    "generate/plan.py",
    "generate/shard.py",
)
"""Folders and modules that decide the bytes of a dataset, besides the modules at the top of the package."""


@cache
def code_fingerprint() -> str:
    """Return 16 hexadecimal digits that change with the deciding sources, library versions or processor type."""
    package = Path(dynahoi_lerobot.__file__).parent
    digest = hashlib.sha256(platform.machine().encode())
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix()
        if "/" not in name or name.startswith(DECIDING_SOURCES):
            digest.update(name.encode())
            digest.update(path.read_bytes())
    for library in LIBRARIES:
        digest.update(f"{library}={_version(library)}".encode())
    return digest.hexdigest()[:16]


def extension_fingerprint(classes: Iterable[type]) -> str:
    """Return hashes of the files outside this package that define some of ``classes``; empty if there are none."""
    modules = {entry.__module__ for entry in classes}
    return "".join(_module_hash(module) for module in sorted(modules) if not module.startswith("dynahoi_lerobot."))


@cache
def _module_hash(module: str) -> str:
    path = getattr(sys.modules[module], "__file__", None)  # none for classes typed into a console
    source = Path(path).read_bytes() if path else b""
    return hashlib.sha256(module.encode() + source).hexdigest()[:16]


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "absent"
