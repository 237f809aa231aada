"""What code made a dataset: a hash of the sources and versions that decide its bytes."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import dynahoi_lerobot

LIBRARIES = ("numpy", "mujoco", "mujoco-warp", "warp-lang", "av", "pyarrow", "pillow")
"""Libraries whose versions may change states, pixels or files."""

READERS = (
    "cli.py",
    "env.py",
    "evaluate/",
    "listing.py",
    "metrics/",
    "quickstart.py",
    "report/",
    "view.py",
    "generate/checks/",
    "generate/command.py",
    "generate/datatrove_steps.py",
    "generate/executors/",
    "generate/outliers.py",
    "generate/replay.py",
    "generate/resimulate.py",
    "generate/verify",
    "generate/workers.py",
)
"""Parts of the package that read datasets, play policies or spread work; they decide no byte of a dataset."""


@cache
def code_fingerprint() -> str:
    """Return 16 hexadecimal digits that change with the generating sources, library versions or processor kind."""
    package = Path(dynahoi_lerobot.__file__).parent
    digest = hashlib.sha256(platform.machine().encode())
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix()
        if not name.startswith(READERS):
            digest.update(name.encode())
            digest.update(path.read_bytes())
    for library in LIBRARIES:
        digest.update(f"{library}={_version(library)}".encode())
    return digest.hexdigest()[:16]


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "absent"
