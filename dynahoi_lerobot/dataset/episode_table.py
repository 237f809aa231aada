"""The episode table: LeRobot's columns, and one column per fact about the episode.

Facts are read by ``LeRobotDataset(..., episode_filter=lambda ep: ep["motion"] == "lob")`` and by
``ds.meta.episodes[i]["seed"]``. Below ``stats/`` are LeRobot's statistics, one column for each
feature and statistic, and nothing else: readers take such names apart.
"""

from collections.abc import Iterable
from dataclasses import asdict, fields
from typing import Any, get_type_hints

import numpy as np
import pyarrow as pa

from dynahoi_lerobot.core.episode import Episode, EpisodeMeta
from dynahoi_lerobot.dataset.columns import (
    BOOKKEEPING,
    Features,
    bookkeeping_arrays,
    image_keys,
    numeric_keys,
)  # fmt: skip
from dynahoi_lerobot.dataset.statistics import NAMES, Stats, table_stats

EpisodeRow = dict[str, Any]

STATS_PREFIX = "stats/"
"""Statistics: LeRobot reads an episode's whole row for every sample, but for this prefix."""

FRAME_RANGE = ("dataset_from_index", "dataset_to_index")
"""LeRobot's columns of the first frame of an episode in the dataset, and of the one after it."""

FACTS = {
    field.name: pa.string() if field.type is str else pa.int64() for field in fields(EpisodeMeta)
}
FACTS |= {"success": pa.bool_(), "stage": pa.string()}
"""Our columns that hold one value."""
FACT_TYPES = get_type_hints(EpisodeMeta) | {"success": bool, "stage": str, "tasks": tuple[str]}
"""What an episode needs to be copied; an edited dataset may lack it."""


def own_columns(episode: Episode) -> EpisodeRow:
    """Return our columns of an episode's row: its facts."""
    return asdict(episode.meta) | {"success": bool(episode.success), "stage": episode.stage}


def own_values(row: EpisodeRow) -> dict[str, Any]:
    """Return the attributes of an Episode that its row holds: undoes ``own_columns``.

    Raises:
        KeyError: if a column is missing.
    """
    meta = EpisodeMeta(**{field.name: row[field.name] for field in fields(EpisodeMeta)})
    return {"meta": meta, "success": row["success"], "stage": row["stage"]}


def stats_columns(stats: dict[str, Stats]) -> EpisodeRow:
    """Return ``stats/<key>/<name>`` columns."""
    return {f"stats/{key}/{name}": stats[key][name].tolist() for key in stats for name in NAMES}


def row_stats(row: EpisodeRow, key: str) -> Stats:
    """Return the statistics of one column of the episode from its row."""
    return {name: np.array(row[f"stats/{key}/{name}"]) for name in NAMES}


def video_columns(keys: Iterable[str], place: dict[str, Any]) -> EpisodeRow:
    """Return ``videos/<key>/<name>`` columns; the images of an episode lie at the same place for
    every key.
    """
    return {f"videos/{key}/{name}": value for key in keys for name, value in place.items()}


def place_row(row: EpisodeRow, episode_index: int, first_index: int, task_index: int) -> EpisodeRow:
    """Return the row with its place in the dataset, and the statistics of the columns that depend
    on it.
    """
    length = row["length"]
    arrays = bookkeeping_arrays(length, episode_index, first_index, task_index)
    placed = {
        "episode_index": episode_index,
        "dataset_from_index": first_index,
        "dataset_to_index": first_index + length,
    }
    return row | placed | stats_columns(table_stats(arrays))


def row_schema(features: Features) -> pa.Schema:
    """Return the schema of the episode files."""
    images = image_keys(features)
    videos = [key for key in images if features[key]["dtype"] == "video"]
    types: dict[str, pa.DataType] = {"episode_index": pa.int64(), "tasks": pa.list_(pa.string())}
    numbers = ("length", "data/chunk_index", "data/file_index", *FRAME_RANGE)
    types |= dict.fromkeys(numbers, pa.int64())
    types |= video_columns(videos, dict.fromkeys(("chunk_index", "file_index"), pa.int64()))
    types |= video_columns(videos, dict.fromkeys(("from_timestamp", "to_timestamp"), pa.float64()))
    types |= FACTS
    for key in [*images, *numeric_keys(features)]:
        types |= {f"stats/{key}/{name}": _stat_type(key in images, name) for name in NAMES}
    types |= dict.fromkeys(("meta/episodes/chunk_index", "meta/episodes/file_index"), pa.int64())
    return pa.schema(types)


def _stat_type(image: bool, name: str) -> pa.DataType:
    if name == "count":
        return pa.list_(pa.int64())
    number = pa.list_(pa.float64())
    return pa.list_(pa.list_(number)) if image else number


def without_place(row: EpisodeRow) -> EpisodeRow:
    """Return the row without what ``place_row`` adds, ready to be placed in another dataset."""
    dropped = ("episode_index", *FRAME_RANGE, "meta/", "data/", "videos/")
    stats = tuple(f"stats/{key}/" for key in BOOKKEEPING)
    return {name: value for name, value in row.items() if not name.startswith((*dropped, *stats))}
