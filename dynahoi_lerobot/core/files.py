"""Files and text: unwritable places refused before the work starts, what is written whole, YAML, hashes."""

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml


def check_output(path: Path) -> None:
    """Refuse a file or folder that cannot be made.

    Raises:
        ValueError: if the path lies below a file.
    """
    place = next(place for place in (path, *path.parents) if place.exists())
    if place != path and not place.is_dir():
        raise ValueError(f"{path} cannot be made: {place} is a file")


def write_atomically(writers: Mapping[Path, Callable[[Path], object]]) -> None:
    """Write every file under a temporary name, and rename them only when all are complete and on the disk.

    Args:
        writers: for each path, a function that writes the file to the path it is given. The files are renamed in this
            order, so the presence of the last implies that of the others. Folders are made.
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


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Give the path of a folder to be made, which is renamed to ``target`` at the end.

    Whatever happens before the end, ``target`` does not exist. If somebody has made ``target`` meanwhile, theirs stays.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(".tmp", f".{target.name}.", target.parent, ignore_cleanup_errors=True) as scratch:
        yield (folder := Path(scratch) / target.name)
        try:
            folder.rename(target)
        except OSError:
            if not target.is_dir():
                raise


class _Loader(yaml.SafeLoader):
    """Refuses a key that appears twice, of which YAML would keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if str(key.value) in seen:
                raise yaml.YAMLError(f"key {key.value!r} appears again in line {key.start_mark.line + 1}")
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping that a YAML file holds; nothing but comments is an empty one.

    Raises:
        ValueError: in one sentence that names the file, if it cannot be read, is not YAML in UTF-8, repeats a key or is
            no mapping.
    """
    try:
        values = yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(values, dict | None):
        raise ValueError(f"{path} must map keys to values, got a {type(values).__name__}")
    return values or {}


def printable(text: str) -> str:
    """Return ``text`` with whatever a terminal would obey, such as escapes and line ends, written out."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


def sha256(path: Path) -> str:
    """Return the sha256 of a file in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
