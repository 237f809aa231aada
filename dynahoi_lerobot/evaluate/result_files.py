"""Reading and writing the three files of a result folder; whatever is damaged is one ``ResultsError``.

Nothing in them is compressed, so that their sizes, which are limited by the number of episodes, bound what they decode
to. Every file is read once, and its hash is that of the bytes that were decoded.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_STORED, ZipFile

import numpy as np

from dynahoi_lerobot.core.conventions import HAND_DOF
from dynahoi_lerobot.core.files import printable, write_atomically
from dynahoi_lerobot.evaluate.rows import COLUMNS, COUNTS, Row, check_row, row_schema

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
    "extra": dict,
}
"""Keys of ``metrics.json`` with the types of their values; ``extra`` may be missing."""

UNIFORM = ("capture", "benchmark", "protocol", "control_class")
"""Columns with one value in all rows; the first two have that of ``metrics.json``."""
MOST_EPISODES = 20_000
"""Episodes of results that are read."""
LARGEST_EPISODE = 2**16
"""Bytes of an episode in any of the files; its commands have 36,864 if it is as long as any."""
HEADER, LARGEST_HEAD = 2**17, 2**24
"""Bytes that those files may have besides, and that ``metrics.json`` may have."""
LONGEST_TEXT, LONGEST_NAME, MOST_NAMES = 4096, 256, 256
"""Characters of a text in ``metrics.json``, and of one in a row; different texts of a column."""
ARRAYS = {"action": "f4", "offsets": "i8", "seed": "i8", "window_frames": "i8"}
"""Arrays of ``actions.npz``: the commands of all episodes end to end, those of episode i from ``offsets[i]`` on."""

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


def read(folder: Path) -> tuple[dict[str, Any], list[Row], list[np.ndarray], dict[str, str]]:
    """Return the content of ``metrics.json``, the rows, the (T, 18) actions of every episode and the files' sha256.

    Raises:
        ResultsError: one sentence that says what is missing or damaged.
    """
    head, digest = _load(folder, METRICS_FILE, _read_head, LARGEST_HEAD)
    most = min(head["n"], MOST_EPISODES) * LARGEST_EPISODE + HEADER
    rows, rows_digest = _load(folder, EPISODES_FILE, _read_rows, most)
    actions, actions_digest = _load(folder, ACTIONS_FILE, partial(_read_actions, rows=rows), most)
    if not head["n"] == len(rows) == len(actions) > 0:
        counts = f"{METRICS_FILE} {head['n']}, {EPISODES_FILE} {len(rows)}, {ACTIONS_FILE} {len(actions)}"
        raise ResultsError(f"the files in {folder} disagree on the episodes: {counts}; {REMEDY}")
    for name in UNIFORM:
        if len(found := sorted({row[name] for row in rows} | {head[name] for name in [name] if name in head})) > 1:
            raise ResultsError(f"{folder} holds episodes of {name} {found[0]!r} and {found[1]!r}; {REMEDY}")
    return head, rows, actions, {METRICS_FILE: digest, EPISODES_FILE: rows_digest, ACTIONS_FILE: actions_digest}


def read_saved(folder: Path) -> tuple[list[Row], list[np.ndarray]]:
    """Return the rows and actions that an interrupted evaluation has saved, none before its first save.

    It may have ended between the renaming of two files, so that one of them holds more episodes.

    Raises:
        ResultsError: one sentence that says what is damaged.
    """
    if not ((folder / EPISODES_FILE).exists() and (folder / ACTIONS_FILE).exists()):
        return [], []
    most = MOST_EPISODES * LARGEST_EPISODE
    rows, _ = _load(folder, EPISODES_FILE, _read_rows, most)
    actions, _ = _load(folder, ACTIONS_FILE, partial(_read_actions, rows=rows), most)
    return rows[: len(actions)], actions[: len(rows)]


def _load(folder: Path, name: str, reader: Callable[[BytesIO], Any], most: int) -> tuple[Any, str]:
    """Return what a file of at most ``most`` bytes holds, and its sha256."""
    path = folder / name
    if not folder.is_dir():
        raise ResultsError(f"there is no result folder {folder}; {REMEDY}")
    if not path.is_file():
        raise ResultsError(f"{folder} holds no results: {name} is missing; {REMEDY}")
    try:
        if (size := path.stat().st_size) > most:
            raise ValueError(f"{size} bytes are too many for its episodes; allowed are {most}")
        content = path.read_bytes()
        return reader(BytesIO(content)), sha256(content).hexdigest()
    except Exception as error:  # whatever a damaged file makes its reader raise, the remedy is the same
        reason = printable(" ".join(f"{type(error).__name__}: {error}".split()))
        raise ResultsError(f"{path} is damaged ({reason}); {REMEDY}") from error


def _read_head(file: BytesIO) -> dict[str, Any]:
    head = json.loads(file.getvalue().decode("utf-8"), parse_constant=_refuse_constant)
    if not isinstance(head, dict):
        raise TypeError(f"it must hold an object, not {type(head).__name__}")
    head["extra"] = head.get("extra") or {}
    if missing := [key for key in HEAD_TYPES if key not in head]:
        raise KeyError(f"it lacks {', '.join(missing)}")
    if surplus := sorted(head.keys() - HEAD_TYPES.keys()):
        raise KeyError(f"it has the unknown key {surplus[0]!r}")
    for key, wanted in HEAD_TYPES.items():
        if not isinstance(value := head[key], wanted) or isinstance(value, bool):
            raise TypeError(f"{key} must be of type {wanted.__name__}, got {type(value).__name__}")
    if not isinstance(inference := head["extra"].get("inference") or "", str):
        raise TypeError(f"inference must be a text such as 'async 150 ms', got {inference!r}")
    for text in _texts(head):
        if len(text) > LONGEST_TEXT:
            raise ValueError(f"its texts may have {LONGEST_TEXT} characters, got {len(text)}")
        _check_printable(text)
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


def _check_printable(text: str) -> None:
    """Refuse a text that would be obeyed by the terminal that it is printed on."""
    if not text.isprintable():
        raise ValueError(f"its texts must be printable, got {text[:80]!r}")


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _write_rows(path: Path, rows: Sequence[Row]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_pylist(list(rows), schema=row_schema()), path, compression="none")


def _read_rows(file: BytesIO) -> list[Row]:
    """Return the rows; texts are decoded once they are known to be short."""
    import pyarrow.parquet as pq

    schema, stored = row_schema(), pq.read_schema(file)
    texts = [name for name, kind in COLUMNS.items() if kind == "string"]
    parquet = pq.ParquetFile(file, read_dictionary=texts)  # equal texts stay one text, however many rows have it
    data = parquet.metadata
    if not 0 < data.num_rows <= MOST_EPISODES:
        raise ValueError(f"it has {data.num_rows} rows; allowed are 1 to {MOST_EPISODES}")
    if differing := sorted(set(stored.names) ^ set(schema.names)) or [
        field.name for field in schema if stored.field(field.name) != field
    ]:
        raise TypeError(f"its column {differing[0]} is not one of {EPISODES_FILE}, or there twice, or of another type")
    groups = [data.row_group(i) for i in range(data.num_row_groups)]
    if {group.column(i).compression for group in groups for i in range(data.num_columns)} != {"UNCOMPRESSED"}:
        raise ValueError("its columns must not be compressed")
    table = parquet.read()
    for name in texts:
        _check_names(name, {text for chunk in table.column(name).chunks for text in _different(chunk)})
    rows = table.select(schema.names).cast(schema).to_pylist()
    for row in rows:
        check_row(row)
    return rows


def _different(chunk: Any) -> list[str | None]:
    return (chunk.dictionary if hasattr(chunk, "dictionary") else chunk.unique()).to_pylist()


def _check_names(column: str, names: set[str | None]) -> None:
    """Refuse texts of a column that are too many, too long, or more than text."""
    if len(names) > MOST_NAMES:
        raise ValueError(f"{column} may have {MOST_NAMES} different texts, got {len(names)}")
    for name in filter(None, names):
        if len(name) > LONGEST_NAME:
            raise ValueError(f"texts of {column} may have {LONGEST_NAME} characters, got {len(name)}")
        _check_printable(name)


def _write_actions(path: Path, rows: Sequence[Row], actions: Sequence[np.ndarray]) -> None:
    with path.open("wb") as file:  # an open file, because numpy appends .npz to a path
        np.savez(
            file,
            action=np.concatenate(list(actions)).reshape(-1, HAND_DOF),
            offsets=np.cumsum([0, *map(len, actions)]),
            seed=np.array([row["seed"] for row in rows], np.int64),
            window_frames=np.array([row["window_frames"] for row in rows], np.int64),
        )


def _read_actions(file: BytesIO, rows: Sequence[Row]) -> list[np.ndarray]:
    """Return the (T, 18) actions of all episodes, of which the first are those of ``rows``."""
    with ZipFile(file) as members:
        if any(member.compress_type != ZIP_STORED for member in members.infolist()):
            raise ValueError("its arrays must not be compressed")
    with np.load(file, allow_pickle=False) as archive:
        if set(archive.files) != set(ARRAYS) or len(archive.files) != len(ARRAYS):
            raise KeyError(f"it must hold {', '.join(sorted(ARRAYS))}, not {', '.join(archive.files)[:LONGEST_TEXT]}")
        arrays = {name: archive[name] for name in ARRAYS}
    actions, offsets = arrays["action"], arrays["offsets"]
    for name, array in arrays.items():
        columns = (HAND_DOF,) if name == "action" else ()
        if array.dtype != ARRAYS[name] or array.shape[1:] != columns or not len(array):
            raise ValueError(f"{name} must not be {array.shape} {array.dtype}")
    for name in arrays.keys() & set(COUNTS):
        wanted = [row[name] for row in rows][: len(arrays[name])]
        if len(arrays[name]) != len(offsets) - 1 or arrays[name][: len(rows)].tolist() != wanted:
            raise ValueError(f"its {name} are not those of {EPISODES_FILE}")
    if not np.isfinite(actions).all():
        raise ValueError("an action is not a finite number")
    if offsets[0] != 0 or offsets[-1] != len(actions) or (np.diff(offsets) < 1).any():
        raise ValueError(f"offsets must rise from 0 to {len(actions)}")
    return np.split(actions, offsets[1:-1])
