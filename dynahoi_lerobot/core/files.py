"""Writing: unwritable places are refused before the work starts, and files appear whole."""

import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path


def check_output(path: Path) -> None:
    """Refuse a file or folder that cannot be made; ValueError if the path lies below a file."""
    place = next(place for place in (path, *path.parents) if place.exists())
    if place != path and not place.is_dir():
        raise ValueError(f"{path} cannot be made: {place} is a file")


def write_atomically(writers: Mapping[Path, Callable[[Path], object]]) -> None:
    """Write every file under a temporary name, and rename them only when all are complete and on
    the disk.

    Args:
        writers: for each path, a function that writes the file to the path it is given. The files
            are renamed in this order, so if the last is there, all are.
            Folders are made.
    """
    drafts = {path: path.with_name(f".{path.name}.{os.getpid()}.part") for path in writers}
    try:
        for path, write in writers.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write(drafts[path])
            with drafts[path].open("rb") as draft:
                os.fsync(draft.fileno())
        for path, draft in drafts.items():
            draft.replace(path)
    finally:
        for draft in drafts.values():
            draft.unlink(missing_ok=True)


def write_text_atomically(path: Path, text: str) -> None:
    """Write a text file, in UTF-8, whole or not at all; folders are made."""
    write_atomically({path: lambda draft: draft.write_text(text, encoding="utf-8")})


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Hold a folder until its process ends; OSError if another one does."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Give the path of a folder to be made, which is renamed to ``target`` at the end.

    Whatever happens before the end, ``target`` does not exist. What a killed process has left of
    the same folder is removed.

    Raises:
        FileExistsError: at the end, if somebody has made ``target`` meanwhile; theirs stays.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    for left in target.parent.glob(f".{glob.escape(target.name)}.*.tmp"):
        with suppress(OSError), _held(left):
            shutil.rmtree(left)
    with (
        tempfile.TemporaryDirectory(
            ".tmp", f".{target.name}.", target.parent, ignore_cleanup_errors=True
        ) as scratch,
        _held(Path(scratch)),
    ):
        folder = Path(scratch) / target.name
        yield folder
        try:
            folder.rename(target)
        except OSError as error:
            if not target.exists():
                raise
            raise FileExistsError(
                f"{target} was made by another process meanwhile and stays; choose a new folder"
            ) from error
