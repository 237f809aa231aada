"""Whether a dataset's tables can be read at all, and whether other tools have rewritten it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.dataset.columns import arrow_schema
from dynahoi_lerobot.dataset.episode_table import OWN_COLUMNS, row_schema
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import HISTOGRAMS_PATH, INFO_PATH, MANIFEST_PATH, STATS_PATH, TASKS_PATH
from dynahoi_lerobot.dataset.store import Store

DTYPES = ("float32", "int64", "bool", "image", "video", "language")
SHOWN = 5
"""Columns that a finding names."""


def unreadable(root: Path) -> Iterator[str]:
    """Yield a sentence for each table that is missing or cannot be read; without them nothing else can be checked."""
    store = Store(root)
    readers: dict[str, Callable[[Path], object]] = {
        INFO_PATH: _info,
        STATS_PATH: _object,
        HISTOGRAMS_PATH: _object,
        MANIFEST_PATH: lambda path: Manifest.read(root),
        TASKS_PATH: lambda path: _table(path, ["task", "task_index"]),
    }
    problems = [problem for name, read in readers.items() if (problem := _problem(root / name, name, read))]
    yield from problems
    if any(problem.startswith(INFO_PATH) for problem in problems):
        return
    for folder, paths, columns in (
        ("meta/episodes", store.row_files(), row_schema(store.features).names),
        ("data", store.data_files(), arrow_schema(store.features).names),
    ):
        if not paths:
            yield f"{folder} holds no parquet file"
        for path in paths:
            name = path.relative_to(root).as_posix()
            if problem := _problem(path, name, lambda path, columns=columns: _table(path, columns)):
                yield problem


def _problem(path: Path, name: str, read: Callable[[Path], object]) -> str | None:
    try:
        read(path)
    except FileNotFoundError:
        return f"{name} is missing"
    except (OSError, ValueError, KeyError, TypeError, RecursionError, pa.ArrowException) as error:
        return f"{name} cannot be read: {(str(error).splitlines() or [type(error).__name__])[0]}"
    return None


def rewritten(root: Path) -> str | None:
    """Return a sentence about what is gone if another tool has written the dataset anew, None otherwise.

    LeRobot's own tools that delete, merge, split or remove something copy neither our files under ``meta/`` nor our
    columns of the episode table.
    """
    gone = [name for name in (MANIFEST_PATH, HISTOGRAMS_PATH) if not (root / name).exists()]
    if MANIFEST_PATH not in gone or HISTOGRAMS_PATH not in gone:
        return None
    try:
        held = {name for path in Store(root).row_files() for name in pq.read_schema(path).names}
    except (OSError, pa.ArrowException):
        return None
    columns = [name for name in OWN_COLUMNS if name not in held]
    lost = f", and {len(columns)} columns of the episode table ({', '.join(columns[:3])}, ...)" if columns else ""
    return (
        f"this dataset was written anew by another tool, as LeRobot's are: {' and '.join(gone)} are gone{lost}, so "
        "nothing says any more what it should hold, and only LeRobot's format is checked; `dynahoi filter` copies "
        "episodes with them"
    )


def _object(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_text())
    if not isinstance(content, dict):
        raise ValueError(f"it holds a {type(content).__name__}, not an object")
    return content


def _info(path: Path) -> None:
    features = _object(path).get("features")
    described = isinstance(features, dict) and all(
        isinstance(feature, dict)
        and feature.get("dtype") in DTYPES
        and isinstance(shape := feature.get("shape"), list)
        and shape
        and all(isinstance(side, int) and side > 0 for side in shape)
        for feature in features.values()
    )
    if not described:
        raise ValueError("it has no table of features with a known dtype and a shape each")


def _table(path: Path, columns: list[str]) -> None:
    if path.is_dir():
        raise ValueError("it is a folder")
    if missing := sorted(set(columns) - set(pq.read_schema(path).names)):
        raise ValueError(f"it lacks the columns {', '.join(missing[:SHOWN])}{', ...' if len(missing) > SHOWN else ''}")
    if not pq.read_table(path).num_rows:
        raise ValueError("it has no rows")
