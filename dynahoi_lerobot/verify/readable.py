"""Whether a dataset's tables can be read at all, and whether other tools have rewritten it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.dataset.episode_table import OWN_COLUMNS
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import HISTOGRAMS_PATH, INFO_PATH, MANIFEST_PATH, STATS_PATH, TASKS_PATH
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.tables import read_tasks

NOT_READ = "cannot be read"


def unreadable(root: Path) -> Iterator[str]:
    """Yield a sentence for each table that is missing or cannot be read; without them nothing else can be checked."""
    store = Store(root)
    readers: dict[str, Callable[[Path], object]] = {
        INFO_PATH: _info,
        STATS_PATH: _object,
        HISTOGRAMS_PATH: _object,
        TASKS_PATH: read_tasks,
        MANIFEST_PATH: lambda path: Manifest.read(root),
    }
    tables = [path.relative_to(root).as_posix() for path in (*store.row_files(), *store.data_files())]
    for name, read in {**readers, **dict.fromkeys(tables, pq.read_table)}.items():
        try:
            read(root / name)
        except FileNotFoundError:
            yield f"{name} is missing"
        except (OSError, ValueError, KeyError, RecursionError, pa.ArrowException) as error:
            yield f"{name} {NOT_READ}: {_first_line(error)}"
    for folder, found in (("meta/episodes", store.row_files()), ("data", store.data_files())):
        if not found:
            yield f"{folder} holds no parquet file"


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
        "nothing says any more what it should hold; `dynahoi filter` copies episodes with them"
    )


def _object(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_text())
    if not isinstance(content, dict):
        raise ValueError(f"it holds a {type(content).__name__}, not an object")
    return content


def _info(path: Path) -> None:
    features = _object(path).get("features")
    sound = isinstance(features, dict) and all(
        isinstance(feature, dict) and {"dtype", "shape", "names"} <= feature.keys() for feature in features.values()
    )
    if not sound:
        raise ValueError("it has no table of features with dtype, shape and names")


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
