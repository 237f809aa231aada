"""Atomic writing of files: write a temporary file in the same folder, then rename it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


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
