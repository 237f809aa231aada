"""Reading and writing the three files of a result folder; whatever is damaged is one ``ResultsError``."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.core.conventions import HAND_DOF
from dynahoi_lerobot.core.files import printable, write_atomically
from dynahoi_lerobot.evaluate.rows import Row, row_schema

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


def read(folder: Path) -> tuple[dict[str, Any], list[Row], list[np.ndarray]]:
    """Return the content of ``metrics.json``, the rows and the (T, 18) actions of every episode.

    Raises:
        ResultsError: one sentence that says what is missing or damaged.
    """
    head = _load(folder / METRICS_FILE, _read_head)
    rows, actions = read_saved(folder)
    if not head["n"] == len(rows) == len(actions) > 0:
        counts = f"{METRICS_FILE} {head['n']}, {EPISODES_FILE} {len(rows)}, {ACTIONS_FILE} {len(actions)}"
        raise ResultsError(f"the files in {folder} disagree on the episodes: {counts}; {REMEDY}")
    for name in UNIFORM:
        if len(found := sorted({row[name] for row in rows} | {head[name] for name in [name] if name in head})) > 1:
            raise ResultsError(f"{folder} holds episodes of {name} {found[0]!r} and {found[1]!r}; {REMEDY}")
    return head, rows, actions


def read_saved(folder: Path) -> tuple[list[Row], list[np.ndarray]]:
    """Return the rows and actions of a folder, whose numbers differ if its last save ended between two files.

    Raises:
        ResultsError: one sentence that says what is missing or damaged.
    """
    rows = _load(folder / EPISODES_FILE, _read_rows)
    return rows, _load(folder / ACTIONS_FILE, lambda path: _read_actions(path, rows))


def _load[T](path: Path, reader: Callable[[Path], T]) -> T:
    if not path.parent.is_dir():
        raise ResultsError(f"there is no result folder {path.parent}; {REMEDY}")
    if not path.is_file():
        raise ResultsError(f"{path.parent} holds no results: {path.name} is missing; {REMEDY}")
    try:
        return reader(path)
    except Exception as error:  # whatever a damaged file makes its reader raise, the remedy is the same
        reason = printable(" ".join(f"{type(error).__name__}: {error}".split()))
        raise ResultsError(f"{path} is damaged ({reason}); {REMEDY}") from error


def _read_head(path: Path) -> dict[str, Any]:
    head = {"extra": {}} | json.loads(path.read_text(encoding="utf-8"))
    for key, wanted in HEAD_TYPES.items():
        if not isinstance(value := head[key], wanted):
            raise TypeError(f"{key} must be of type {wanted.__name__}, got {type(value).__name__}")
    return head


def _write_rows(path: Path, rows: Sequence[Row]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_pylist(list(rows), schema=row_schema()), path, compression="none")


def _read_rows(path: Path) -> list[Row]:
    import pyarrow.parquet as pq

    wanted, table = row_schema(), pq.ParquetFile(path).read()
    if set(table.schema) != set(wanted):
        differing = sorted({field.name for field in set(table.schema) ^ set(wanted)})
        raise TypeError(f"its column {differing[0]} is missing, surplus or of another type")
    return table.select(wanted.names).to_pylist()


def _write_actions(path: Path, rows: Sequence[Row], actions: Sequence[np.ndarray]) -> None:
    with path.open("wb") as file:  # an open file, because numpy appends .npz to a path
        np.savez(
            file,
            action=np.concatenate(list(actions)).reshape(-1, HAND_DOF),
            offsets=np.cumsum([0, *map(len, actions)]),
            seed=np.array([row["seed"] for row in rows], np.int64),
            window_frames=np.array([row["window_frames"] for row in rows], np.int64),
        )


def _read_actions(path: Path, rows: Sequence[Row]) -> list[np.ndarray]:
    """Return the (T, 18) actions of all episodes, of which the first are those of ``rows``."""
    with np.load(path, allow_pickle=False) as archive:
        actions, offsets, seeds = archive["action"], archive["offsets"], archive["seed"]
    if actions.shape[1:] != (HAND_DOF,) or offsets[-1] != len(actions):
        raise ValueError(f"its actions must not be of shape {actions.shape}")
    if any(row["seed"] != seed for row, seed in zip(rows, seeds.tolist(), strict=False)):
        raise ValueError(f"its seeds are not those of {EPISODES_FILE}")
    return np.split(actions, offsets[1:-1])
