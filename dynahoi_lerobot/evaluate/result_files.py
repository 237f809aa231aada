"""Reading and writing the three files of a result folder; whatever is damaged is one ``ResultsError``."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from dynahoi_lerobot.evaluate.atomic import write_atomically
from dynahoi_lerobot.evaluate.episode_row import Row, checked_rows, row_schema
from dynahoi_lerobot.foundation.conventions import HAND_DOF

METRICS_FILE = "metrics.json"
EPISODES_FILE = "episodes.parquet"
ACTIONS_FILE = "actions.npz"

HEAD_TYPES: dict[str, type] = {
    "n": int,
    "split": str,
    "policy": str,
    "capture": str,
    "metrics": dict,
    "per_kind": dict,
    "fingerprint": str,
    "benchmark": str,
    "command": str,
}
"""Keys that ``metrics.json`` must have, with the types of their values; ``extra``, a dict, may stand beside them."""

MOST_EPISODES = 100_000
"""Episodes of results that are read."""
LARGEST_EPISODE = 512 * HAND_DOF * 4
"""Bytes of the commands of the longest episode that is read, 512 frames."""
HEADER = 4096
"""Bytes that may stand before the commands of all episodes."""
LARGEST_HEAD = 2**24
"""Bytes of the largest ``metrics.json`` that is read."""
LONGEST_TEXT = 80
"""Characters of a text that is shown because it cannot be printed."""

REMEDY = "run `dynahoi evaluate` with this folder as --out"


class ResultsError(ValueError):
    """A result folder is missing, incomplete or damaged; the message says which and how to get a good one."""


def write(folder: Path, head: dict[str, Any], rows: Sequence[Row], actions: Sequence[np.ndarray]) -> None:
    """Write the three files; ``metrics.json`` is renamed last, so it is there only if the others are.

    Args:
        folder: made if it does not exist.
        head: the content of ``metrics.json``.
        rows: one row an episode.
        actions: one (T, 18) float32 array an episode.
    """
    text = json.dumps(head, indent=2, allow_nan=False) + "\n"
    write_atomically(
        {
            folder / EPISODES_FILE: lambda path: _write_rows(path, rows),
            folder / ACTIONS_FILE: lambda path: _write_actions(path, rows, actions),
            folder / METRICS_FILE: lambda path: path.write_text(text, encoding="utf-8"),
        }
    )


def read_head(folder: Path) -> dict[str, Any]:
    """Return the content of ``metrics.json``.

    Raises:
        ResultsError: one sentence that says what is missing or damaged.
    """
    if not folder.is_dir():
        raise ResultsError(f"there is no result folder {folder}; {REMEDY}")
    return _load(folder / METRICS_FILE, _read_head)


def read(folder: Path) -> tuple[dict[str, Any], list[Row], list[np.ndarray]]:
    """Return the content of ``metrics.json``, the rows and the (T, 18) actions of every episode.

    Raises:
        ResultsError: one sentence that says what is missing or damaged.
    """
    head = read_head(folder)
    rows = _load(folder / EPISODES_FILE, partial(_read_rows, n=head["n"]))
    actions = _load(folder / ACTIONS_FILE, partial(_read_actions, n=head["n"]))
    if not head["n"] == len(rows) == len(actions) > 0:
        counts = f"{METRICS_FILE} {head['n']}, {EPISODES_FILE} {len(rows)}, {ACTIONS_FILE} {len(actions)}"
        raise ResultsError(f"the files in {folder} disagree on the episodes: {counts}; {REMEDY}")
    return head, rows, actions


def _load(path: Path, reader: Callable[[Path], Any]) -> Any:
    if not path.is_file():
        raise ResultsError(f"{path.parent} holds no results: {path.name} is missing; {REMEDY}")
    try:
        return reader(path)
    except Exception as error:  # whatever a damaged file makes its reader raise, the remedy is the same
        raise ResultsError(f"{path} is damaged ({type(error).__name__}: {error}); {REMEDY}") from error


def _read_head(path: Path) -> dict[str, Any]:
    if (size := path.stat().st_size) > LARGEST_HEAD:
        raise ValueError(f"it has {size} bytes; allowed are {LARGEST_HEAD}")
    head = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    if not isinstance(head, dict):
        raise TypeError(f"it must hold an object, not {type(head).__name__}")
    if missing := [key for key in HEAD_TYPES if key not in head]:
        raise KeyError(f"it lacks {', '.join(missing)}")
    for key, wanted in (HEAD_TYPES | {"extra": dict}).items():
        if not isinstance(value := head.get(key) or wanted(), wanted):
            raise TypeError(f"{key} must be of type {wanted.__name__}, got {type(value).__name__}")
    inference = (head.get("extra") or {}).get("inference") or ""
    if not isinstance(inference, str):
        raise TypeError(f"inference must be a text such as 'async 150 ms', got {inference!r}")
    for text in _texts({key: value for key, value in head.items() if key != "command"}):
        if not text.isprintable():  # it would be obeyed by the terminal that it is printed on
            raise ValueError(f"its texts must be printable, got {text[:LONGEST_TEXT]!r}")
    return head


def _texts(value: Any) -> Iterator[str]:
    """Yield every text and key in ``value``, which was JSON."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield key
            yield from _texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _texts(inner)


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _write_rows(path: Path, rows: Sequence[Row]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_pylist(list(rows), schema=row_schema()), path)


def _read_rows(path: Path, n: int) -> list[Row]:
    """Return the rows; nothing is decompressed before their number is known to be ``n``."""
    import pyarrow.parquet as pq

    # opened here, because a path that ends in ``=value`` would be read as a partition
    with path.open("rb") as file:
        parquet = pq.ParquetFile(file)
        if parquet.metadata.num_rows != n or n > MOST_EPISODES:
            counts = f"{METRICS_FILE} {n}, {EPISODES_FILE} {parquet.metadata.num_rows}"
            raise ValueError(f"the files disagree on the episodes: {counts}, or are of more than {MOST_EPISODES}")
        table = parquet.read()
    return checked_rows(table)


def _write_actions(path: Path, rows: Sequence[Row], actions: Sequence[np.ndarray]) -> None:
    """Write all commands end to end; episode i is ``action[offsets[i]:offsets[i + 1]]``."""
    with path.open("wb") as file:  # an open file, because numpy appends .npz to a path
        np.savez_compressed(
            file,
            action=np.concatenate(list(actions)).reshape(-1, HAND_DOF),
            offsets=np.cumsum([0, *map(len, actions)]),
            seed=np.array([row["seed"] for row in rows], np.int64),
            window_frames=np.array([row["window_frames"] for row in rows], np.int64),
        )


def _read_actions(path: Path, n: int) -> list[np.ndarray]:
    """Return the (T, 18) actions of ``n`` episodes; nothing is decompressed that is too large for them."""
    with ZipFile(path) as members:
        size, most = max(member.file_size for member in members.infolist()), n * LARGEST_EPISODE + HEADER
    if size > most:
        raise ValueError(f"{size} bytes are too many for {n} episodes; allowed are {most}")
    with np.load(path, allow_pickle=False) as archive:
        actions, offsets = archive["action"], archive["offsets"]
    if actions.ndim != 2 or actions.shape[1] != HAND_DOF or actions.dtype != np.float32:
        raise ValueError(f"actions must be (K, {HAND_DOF}) float32, not {actions.shape} {actions.dtype}")
    if not np.isfinite(actions).all():
        raise ValueError("an action is not a finite number")
    if offsets.ndim != 1 or offsets.dtype.kind != "i" or len(offsets) < 2:
        raise ValueError(f"offsets must be (N + 1,) integers, not {offsets.shape} {offsets.dtype}")
    if offsets[0] != 0 or offsets[-1] != len(actions) or (np.diff(offsets) < 1).any():
        raise ValueError(f"offsets must rise from 0 to {len(actions)}")
    return np.split(actions, offsets[1:-1])
