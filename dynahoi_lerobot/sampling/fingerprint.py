"""The code fingerprint: a hash of the sources and library versions that decide the bytes of a dataset."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import dynahoi_lerobot

LIBRARIES = ("numpy", "mujoco", "mujoco-warp", "warp-lang", "av", "pyarrow", "pillow")
"""Libraries whose versions may change states, pixels or files."""

DECIDING = (
    "*.py",
    "foundation/**/*.py",
    "objects/**/*.py",
    "motions/**/*.py",
    "hands/**/*.py",
    "scene/**/*.py",
    "renderers/**/*.py",
    "captures/**/*.py",
    "experts/**/*.py",
    "world/**/*.py",
    "sampling/**/*.py",
    "rollout/**/*.py",
    "dataset/**/*.py",
    "generate/plan.py",
    "generate/shard.py",
)
"""The sources that decide what is in a dataset; all others read datasets, play policies or spread work."""


@cache
def code_fingerprint() -> str:
    """Return 16 hexadecimal digits that change with the deciding sources, library versions and processor kind."""
    digest = hashlib.sha256(platform.machine().encode())
    digest.update(hash_sources(Path(dynahoi_lerobot.__file__).parent))
    for library in LIBRARIES:
        digest.update(f"{library}={_version(library)}".encode())
    return digest.hexdigest()[:16]


def hash_sources(package: Path) -> bytes:
    """Return the sha256 of the names and contents of the deciding sources below ``package``."""
    digest = hashlib.sha256()
    for path in sorted(deciding_sources(package)):
        digest.update(path.relative_to(package).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.digest()


def deciding_sources(package: Path) -> Iterator[Path]:
    """Yield the deciding sources below ``package``."""
    for pattern in DECIDING:
        yield from package.glob(pattern)


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "absent"
