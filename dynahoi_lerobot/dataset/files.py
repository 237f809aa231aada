"""Atomic folders and files: complete under their name, or absent."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from pathlib import Path

_RUN = secrets.token_hex(4)
"""Distinguishes this process from an earlier one with the same id, as in restarted containers."""


@contextmanager
def temporary_sibling(target: Path) -> Iterator[Path]:
    """Give the path of a folder to be made beside ``target``, and rename it to ``target`` at the end.

    Whatever happens before the end, ``target`` does not exist. What a killed process of this host left for the same
    target is removed first; an error removes the folder. If another process has made ``target`` meanwhile, its
    result stays: both are the same, because datasets are functions of their recipe.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    remove_stale(target.parent, escape(target.name))
    folder = temporary_name(target)
    try:
        yield folder
        sync_tree(folder)
        _rename(folder, target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def temporary_name(target: Path) -> Path:
    """Return ``.<name>.<host>.<process>.<random>.tmp`` beside ``target``; the name says which process made it."""
    return target.with_name(f".{target.name}.{socket.gethostname()}.{os.getpid()}.{_RUN}.tmp")


def remove_stale(folder: Path, name: str) -> None:
    """Remove temporary files in ``folder`` of processes of this host that have ended.

    Args:
        folder: where to look, not below it.
        name: glob pattern of the targets' names.
    """
    host = re.escape(socket.gethostname())
    pattern = re.compile(rf"\..+\.{host}\.(?P<process>\d+)\.(?P<run>[0-9a-f]{{8}})\.tmp")
    for path in folder.glob(f".{name}.*.tmp"):
        found = pattern.fullmatch(path.name)
        if found and not _is_running(int(found["process"]), found["run"]):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _is_running(process: int, run: str) -> bool:
    """Return whether a process of this host still runs; an earlier one with our process id does not."""
    if process == os.getpid():
        return run == _RUN
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def sync_tree(folder: Path) -> None:
    """Flush every file below ``folder`` to disk, so that a rename cannot survive a power cut without them."""
    for path in [*sorted(folder.rglob("*")), folder]:
        sync(path)


def sync(path: Path) -> None:
    """Flush one file or folder to disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Name the damaged file in whatever its reader raises.

    Raises:
        ValueError: in one sentence.
    """
    try:
        yield
    except (OSError, ValueError, LookupError, TypeError) as error:
        reason = " ".join(str(getattr(error, "strerror", None) or error).split())
        raise ValueError(f"{path} cannot be read ({type(error).__name__}: {reason})") from error


def replace_text(path: Path, text: str) -> None:
    """Write a small file atomically."""
    temporary = temporary_name(path)
    temporary.write_text(text)
    sync(temporary)
    temporary.replace(path)


def link(source: Path, target: Path) -> None:
    """Hard-link a file, or copy it if the file system has no links."""
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
