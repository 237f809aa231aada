"""Folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from pathlib import Path


@contextmanager
def temporary_sibling(target: Path) -> Iterator[Path]:
    """Give the path of a folder to be made beside ``target``, and rename it to ``target`` at the end.

    Whatever happens before the end, ``target`` does not exist. What a killed process left for the same target is
    removed first; an error removes the folder. If another process has made ``target`` meanwhile, its
    result stays: both are the same, because datasets are functions of their recipe.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    for leftover in target.parent.glob(f".{escape(target.name)}.*.tmp"):
        shutil.rmtree(leftover, ignore_errors=True)
    folder = target.parent / f".{target.name}.{socket.gethostname()}-{os.getpid()}.tmp"
    try:
        yield folder
        sync_tree(folder)
        _rename(folder, target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def sync_tree(folder: Path) -> None:
    """Ask the disk to keep every file below ``folder``, so that a rename cannot survive a power cut without them."""
    for path in [*sorted(folder.rglob("*")), folder]:
        sync(path)


def sync(path: Path) -> None:
    """Ask the disk to keep one file or folder."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace_text(path: Path, text: str) -> None:
    """Write a small file so that readers see the old text or the new one, never a part."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text)
    sync(temporary)
    temporary.replace(path)


def link(source: Path, target: Path) -> None:
    """Give a file a second name; copy it where the file system has no links."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        target.hardlink_to(source)
    except OSError:
        shutil.copyfile(source, target)


def _rename(folder: Path, target: Path) -> None:
    try:
        folder.rename(target)
    except OSError:
        if not target.is_dir():
            raise
    else:
        sync(target.parent)
