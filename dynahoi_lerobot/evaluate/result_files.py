"""Reading and writing the three files of a result folder; whatever is damaged is one ``ResultsError``."""

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

from dynahoi_lerobot.evaluate.episode_row import Row, checked_rows, row_schema
from dynahoi_lerobot.foundation.atomic import write_atomically
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

MOST_EPISODES = 20_000
"""Episodes of results that are read."""
LARGEST_EPISODE = 2**16
"""Bytes of an episode in any of the files; its commands have 36,864 if it is as long as any."""
HEADER, LARGEST_HEAD = 2**17, 2**24
"""Bytes that those files may have besides, and that ``metrics.json`` may have."""
LONGEST_TEXT, LONGEST_NAME = 4096, 256
"""Characters of a text in ``metrics.json``, and of one in a row."""
ARRAYS = {"action", "offsets", "seed", "window_frames"}

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

    Files hold nothing compressed, so that their sizes, which are limited, bound what they decode to; every file is read
    once, and its hash is that of the bytes that were decoded.

    Raises:
        ResultsError: one sentence that says what is missing or damaged.
    """
    head, digest = _load(folder, METRICS_FILE, _read_head)
    n = head["n"]
    rows, rows_digest = _load(folder, EPISODES_FILE, partial(_read_rows, n=n), n)
    actions, actions_digest = _load(
        folder, ACTIONS_FILE, partial(_read_actions, seeds=[row["seed"] for row in rows]), n
    )
    if not head["n"] == len(rows) == len(actions) > 0:
        counts = f"{METRICS_FILE} {head['n']}, {EPISODES_FILE} {len(rows)}, {ACTIONS_FILE} {len(actions)}"
        raise ResultsError(f"the files in {folder} disagree on the episodes: {counts}; {REMEDY}")
    return head, rows, actions, {METRICS_FILE: digest, EPISODES_FILE: rows_digest, ACTIONS_FILE: actions_digest}


def _load(folder: Path, name: str, reader: Callable[[BytesIO], Any], n: int = 0) -> tuple[Any, str]:
    """Return what a file of ``n`` episodes holds, and its sha256."""
    path = folder / name
    if not folder.is_dir():
        raise ResultsError(f"there is no result folder {folder}; {REMEDY}")
    if not path.is_file():
        raise ResultsError(f"{folder} holds no results: {name} is missing; {REMEDY}")
    try:
        if (size := path.stat().st_size) > (
            most := min(n, MOST_EPISODES) * LARGEST_EPISODE + HEADER if n else LARGEST_HEAD
        ):
            raise ValueError(f"{size} bytes are too many for {n} episodes; allowed are {most}")
        content = path.read_bytes()
        return reader(BytesIO(content)), sha256(content).hexdigest()
    except Exception as error:  # whatever a damaged file makes its reader raise, the remedy is the same
        raise ResultsError(f"{path} is damaged ({type(error).__name__}: {error}); {REMEDY}") from error


def _read_head(file: BytesIO) -> dict[str, Any]:
    head = json.loads(file.getvalue().decode("utf-8"), parse_constant=_refuse_constant)
    if not isinstance(head, dict):
        raise TypeError(f"it must hold an object, not {type(head).__name__}")
    if missing := [key for key in HEAD_TYPES if key not in head]:
        raise KeyError(f"it lacks {', '.join(missing)}")
    if surplus := sorted(head.keys() - HEAD_TYPES.keys() - {"extra"}):
        raise KeyError(f"it has the unknown key {surplus[0]!r}")
    for key, wanted in (HEAD_TYPES | {"extra": dict}).items():
        if not isinstance(value := head.get(key) or wanted(), wanted):
            raise TypeError(f"{key} must be of type {wanted.__name__}, got {type(value).__name__}")
    inference = (head.get("extra") or {}).get("inference") or ""
    if not isinstance(inference, str):
        raise TypeError(f"inference must be a text such as 'async 150 ms', got {inference!r}")
    for text in _texts(head):
        if not text.isprintable():  # it would be obeyed by the terminal that it is printed on
            raise ValueError(f"its texts must be printable, got {text[:80]!r}")
        if len(text) > LONGEST_TEXT:
            raise ValueError(f"its texts may have {LONGEST_TEXT} characters, got {len(text)}")
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

    pq.write_table(pa.Table.from_pylist(list(rows), schema=row_schema()), path, compression="none")


def _read_rows(file: BytesIO, n: int) -> list[Row]:
    """Return the ``n`` rows; texts are decoded once they are known to be short."""
    import pyarrow.parquet as pq

    schema = row_schema()
    texts = [field.name for field in schema if str(field.type) == "string"]
    stored = pq.read_schema(file)
    parquet = pq.ParquetFile(file, read_dictionary=texts)  # equal texts stay one text, however many rows have it
    data = parquet.metadata
    if data.num_rows != n or not 0 < n <= MOST_EPISODES:
        raise ValueError(f"it has {data.num_rows} rows, {METRICS_FILE} says {n}; allowed are {MOST_EPISODES}")
    if differing := sorted(set(stored.names) ^ set(schema.names)) or [
        f.name for f in schema if stored.field(f.name) != f
    ]:
        raise TypeError(f"its column {differing[0]} is not one of {EPISODES_FILE}, or there twice, or of another type")
    groups = [data.row_group(i) for i in range(data.num_row_groups)]
    if {group.column(i).compression for group in groups for i in range(data.num_columns)} != {"UNCOMPRESSED"}:
        raise ValueError("its columns must not be compressed")
    table = parquet.read()
    for name in texts:
        for chunk in table.column(name).chunks:
            values = chunk.dictionary if hasattr(chunk, "dictionary") else chunk
            if (longest := max((len(text) for text in values.to_pylist() if text), default=0)) > LONGEST_NAME:
                raise ValueError(f"texts of {name} may have {LONGEST_NAME} characters, got {longest}")
    return checked_rows(table.select(schema.names).cast(schema))


def _write_actions(path: Path, rows: Sequence[Row], actions: Sequence[np.ndarray]) -> None:
    """Write all commands end to end; episode i is ``action[offsets[i]:offsets[i + 1]]``."""
    with path.open("wb") as file:  # an open file, because numpy appends .npz to a path
        np.savez(
            file,
            action=np.concatenate(list(actions)).reshape(-1, HAND_DOF),
            offsets=np.cumsum([0, *map(len, actions)]),
            seed=np.array([row["seed"] for row in rows], np.int64),
            window_frames=np.array([row["window_frames"] for row in rows], np.int64),
        )


def _read_actions(file: BytesIO, seeds: Sequence[int]) -> list[np.ndarray]:
    """Return the (T, 18) actions of the episodes with these ``seeds``."""
    with ZipFile(file) as members:
        if any(member.compress_type != ZIP_STORED for member in members.infolist()):
            raise ValueError("its arrays must not be compressed")
    with np.load(file, allow_pickle=False) as archive:
        if set(archive.files) != ARRAYS or len(archive.files) != len(ARRAYS):
            raise KeyError(f"it must hold {', '.join(sorted(ARRAYS))}, not {', '.join(archive.files)[:LONGEST_TEXT]}")
        actions, offsets, stored_seeds = archive["action"], archive["offsets"], archive["seed"]
    if stored_seeds.tolist() != list(seeds):
        raise ValueError(f"its seeds are not those of {EPISODES_FILE}")
    if actions.ndim != 2 or actions.shape[1] != HAND_DOF or actions.dtype != np.float32:
        raise ValueError(f"actions must be (K, {HAND_DOF}) float32, not {actions.shape} {actions.dtype}")
    if not np.isfinite(actions).all():
        raise ValueError("an action is not a finite number")
    if offsets.ndim != 1 or offsets.dtype.kind != "i" or len(offsets) < 2:
        raise ValueError(f"offsets must be (N + 1,) integers, not {offsets.shape} {offsets.dtype}")
    if offsets[0] != 0 or offsets[-1] != len(actions) or (np.diff(offsets) < 1).any():
        raise ValueError(f"offsets must rise from 0 to {len(actions)}")
    return np.split(actions, offsets[1:-1])
