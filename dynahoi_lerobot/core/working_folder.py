"""Working folders: made, claimed by one process for one task, and resumed by the same task."""

import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.files import write_text_atomically
from dynahoi_lerobot.core.reading import ReadError, read_object

LOCK = "lock"
TASK = "plan.json"
"""Files of a working folder besides the work: its process's lock and its task."""


def workspace_path(root: Path) -> Path:
    """Return where a dataset is made until ``root`` holds all of it."""
    root = root.absolute()
    return root.with_name(f"{root.name}.partial")


@contextmanager
def resumable() -> Iterator[None]:
    """Let the message of an interruption say that the same command goes on from there."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt("run the same command to resume") from None


@contextmanager
def working_folder(path: Path, task: dict[str, Any]) -> Iterator[Path]:
    """Make a folder, or enter the folder of an interrupted run of the same task, given as JSON
    values, and hold its lock.

    A run that fails before it has made anything leaves no folder.

    Raises:
        BlockingIOError: if another process works in it.
        FileExistsError: if it belongs to another task, or no task made it.
    """
    if path.exists() and not path.is_dir():
        raise FileExistsError(f"{path} is a file; remove it or choose another folder")
    path.mkdir(parents=True, exist_ok=True)
    _refuse_foreign(path)
    try:
        with resumable(), exclusive(path):
            _claim(path, task)
            try:
                yield path
            except BaseException:
                if {entry.name for entry in path.iterdir()} <= {TASK, LOCK}:
                    (path / TASK).unlink(missing_ok=True)
                raise
    finally:
        with suppress(OSError):  # there is work in it
            path.rmdir()


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold a folder's lock, which the kernel releases when its holder ends, however that happens.

    Raises:
        BlockingIOError: if another process holds it.
        FileExistsError: if a link, hard or symbolic, has the lock's name; what it leads to would be
            overwritten.
    """
    lock = folder / LOCK
    if lock.is_symlink() or (lock.exists() and not (lock.is_file() and lock.stat().st_nlink == 1)):
        raise FileExistsError(f"{lock} is a link, not a lock; remove it or choose another folder")
    with lock.open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            holder = file.read() or "another process"
            raise BlockingIOError(f"{holder} works in {folder}; wait for it to end") from None
        try:
            file.truncate(0)
            file.write(f"process {os.getpid()} on {socket.gethostname()}")
            file.flush()
            yield
        finally:
            lock.unlink(missing_ok=True)


def read_task(path: Path) -> dict[str, Any] | None:
    """Return the task that a folder belongs to, None if it cannot be read."""
    with suppress(ReadError):
        return read_object(path / TASK)
    return None


def differences(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    """Name what differs between two tasks, at any depth of their mappings; empty if nothing
    does.
    """
    names: list[str] = []
    for key, value in wanted.items():
        inner = found.get(key)
        if isinstance(value, dict) and isinstance(inner, dict):
            names += filter(None, [differences(inner, value)])
        elif inner != value:
            names.append(key)
    return ", ".join(names)


def _refuse_foreign(path: Path) -> None:
    """Refuse a folder with content but without a task; an interrupted start may have left its
    lock.
    """
    if (path / TASK).exists():
        return
    names = sorted(entry.name for entry in path.iterdir())
    foreign = [name for name in names if name != LOCK and not name.startswith(f".{TASK}.")]
    if foreign:
        raise FileExistsError(
            f"{path} holds {foreign[0]} but no {TASK}, so it is not the folder of an interrupted "
            f"run; remove it or "
            "choose another folder"
        )


def _claim(path: Path, task: dict[str, Any]) -> None:
    """Write the task into a new folder or compare it with the task of an old one; remove drafts
    of killed processes.
    """
    if (path / TASK).exists():
        _refuse_other(path, task)
    else:
        write_text_atomically(path / TASK, json.dumps(task, indent=4))
    for draft in path.glob(".*.part"):
        draft.unlink()


def _refuse_other(path: Path, task: dict[str, Any]) -> None:
    """Refuse a folder that belongs to another task."""
    found = read_task(path)
    if found is None:
        raise FileExistsError(
            f"{path / TASK} cannot be read; remove {path} or choose another folder"
        )
    names = differences(found, json.loads(json.dumps(task)))
    if names:
        raise FileExistsError(
            f"{path} holds the work of another run (other {names}); remove it or choose another "
            f"folder"
        )
