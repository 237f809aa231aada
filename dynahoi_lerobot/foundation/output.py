"""Refuse unwritable output places before the work starts."""

from __future__ import annotations

import os
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
