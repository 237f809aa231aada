"""Files: refuse unwritable places before the work starts, write atomically, hash."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

MAX_NAME_BYTES = 180
"""File systems allow 255; temporary names beside the output add host, process and a random number."""


def check_output(path: Path) -> None:
    """Refuse a file or folder that cannot be made, or written to if it exists.

    Raises:
        ValueError: if the path is a link to nothing, lies below a file or below a link to nothing, or has too long a
            name.
    """
    if "\0" in str(path):
        raise ValueError(f"a path cannot hold a null character, got {str(path)!r}")
    for name in path.parts:
        if (size := len(os.fsencode(name))) > MAX_NAME_BYTES:
            raise ValueError(
                f"a name in the output path has {size} bytes; it may have {MAX_NAME_BYTES}: {name[:20]}..."
            )
    for place in (path, *path.parents):
        if place.is_symlink() and not place.exists():
            raise ValueError(f"{place} is a link to {os.readlink(place)}, which does not exist; choose another place")
        if place.exists():
            break
    if place != path and not place.is_dir():
        raise ValueError(f"{path} cannot be made: {place} is a file")


def write_atomically(writers: dict[Path, Callable[[Path], object]]) -> None:
    """Write every file under a temporary name, and rename them only when all are complete.

    Args:
        writers: for each path, a function that writes the file to the path it is given. The files are renamed in this
            order, so the presence of the last implies that of the others. Folders are made.
    """
    temporary = {path: path.with_name(f".{path.name}.{os.getpid()}.part") for path in writers}
    try:
        for path, write in writers.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write(temporary[path])
        for path, file in temporary.items():
            file.replace(path)
    finally:
        for file in temporary.values():
            file.unlink(missing_ok=True)


def sha256(path: Path) -> str:
    """Return the sha256 of a file in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
