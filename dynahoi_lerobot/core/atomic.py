"""Atomic files and folders: complete under their name, or absent."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dynahoi_lerobot.core.working_folder import empty, working_folder

RECORD = "target.json"


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Give the path of a folder to be made, which is renamed to ``target`` at the end.

    Whatever happens before the end, ``target`` does not exist. If somebody has made ``target`` meanwhile, theirs stays.

    Raises:
        BlockingIOError: if another process makes ``target``.
    """
    with _scratch_beside(target) as scratch:
        yield (folder := scratch / target.name)
        for path in [*sorted(folder.rglob("*")), folder]:
            _sync(path)
        try:
            folder.rename(target)
        except OSError:
            if not target.is_dir():
                raise
        _sync(target.parent)


@contextmanager
def _scratch_beside(target: Path) -> Iterator[Path]:
    """Give a folder beside ``target`` that is removed at the end, empty but for what claims it for this process."""
    scratch = target.with_name(f".{target.name}.tmp")
    with working_folder(scratch, {"target": target.name}, RECORD):
        empty(scratch, RECORD)  # of what a killed process left
        try:
            yield scratch
        finally:
            with suppress(OSError):
                empty(scratch, RECORD)
                shutil.rmtree(scratch)


def _sync(path: Path) -> None:
    """Flush one file or folder to disk, so that a rename cannot survive a power cut without it."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
