"""The episode table: LeRobot's columns, then one plain column per fact about the episode.

They are read by ``LeRobotDataset(..., episode_filter=lambda ep: ep["motion"] == "lob")`` and by
``ds.meta.episodes[i]["seed"]``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import pyarrow as pa

from dynahoi_lerobot.dataset.columns import BOOKKEEPING, Features, bookkeeping_arrays, numeric_keys, picture_keys
from dynahoi_lerobot.dataset.statistics import LEVELS, NAMES, Stats, table_stats
from dynahoi_lerobot.episode import Episode, EpisodeMeta

EpisodeRow = dict[str, Any]

TRACES = ("palm_distance", "fingertip_distance", "open_joints", "reference_joints")
"""Arrays of an Episode that are no per-frame column; metrics need them, so the episode table keeps them.

Their columns are called ``stats/<name>``: LeRobot reads an episode's whole row for every sample, but for columns of
that prefix.
"""

HISTOGRAM = "stats/histogram_of:"
"""Before a picture's key: column with the 3 x 256 counts of the episode's sample, from which datasets sum theirs."""

_META = {field.name: pa.string() if field.type == "str" else pa.int64() for field in fields(EpisodeMeta)}
_OWN = (
    _META | {"success": pa.bool_(), "stage": pa.string()} | {f"stats/{name}": pa.list_(pa.float32()) for name in TRACES}
)
OWN_COLUMNS = tuple(_OWN)
"""Our columns of the episode table."""

META_COLUMNS = tuple(_META)
"""Those of them that are fields of EpisodeMeta."""


def own_columns(episode: Episode) -> EpisodeRow:
    """Return our columns of the episode's row."""
    traces = {f"stats/{name}": np.asarray(getattr(episode, name), np.float32).tolist() for name in TRACES}
    return asdict(episode.meta) | {"success": bool(episode.success), "stage": episode.stage} | traces


def stats_columns(stats: dict[str, Stats]) -> EpisodeRow:
    """Return ``stats/<key>/<name>`` columns."""
    return {f"stats/{key}/{name}": stats[key][name].tolist() for key in stats for name in NAMES}


def row_histogram(row: EpisodeRow, key: str) -> np.ndarray:
    """Return the (3, 256) counts of the episode's sampled pictures."""
    return np.array(row[HISTOGRAM + key], np.int64).reshape(3, LEVELS)


def video_columns(keys: Iterable[str], place: dict[str, Any]) -> EpisodeRow:
    """Return ``videos/<key>/<name>`` columns; the pictures of an episode lie at the same place for every key."""
    return {f"videos/{key}/{name}": value for key in keys for name, value in place.items()}


def row_stats(row: EpisodeRow, key: str) -> Stats:
    """Return the statistics of one column of the episode from its row."""
    return {name: np.array(row[f"stats/{key}/{name}"]) for name in NAMES}


def place_row(row: EpisodeRow, episode_index: int, first_index: int, task_index: int) -> EpisodeRow:
    """Return the row with its place in the dataset, and the statistics of the columns that depend on it."""
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
    pictures = picture_keys(features)
    videos = [key for key in pictures if features[key]["dtype"] == "video"]
    columns: dict[str, pa.DataType] = {"episode_index": pa.int64(), "tasks": pa.list_(pa.string())}
    columns |= {"length": pa.int64(), "data/chunk_index": pa.int64(), "data/file_index": pa.int64()}
    columns |= {"dataset_from_index": pa.int64(), "dataset_to_index": pa.int64()}
    columns |= video_columns(videos, dict.fromkeys(("chunk_index", "file_index"), pa.int64()))
    columns |= video_columns(videos, dict.fromkeys(("from_timestamp", "to_timestamp"), pa.float64()))
    columns |= _OWN
    columns |= {HISTOGRAM + key: pa.list_(pa.int64()) for key in pictures}
    for key in [*pictures, *numeric_keys(features)]:
        columns |= {f"stats/{key}/{name}": _stat_type(key in pictures, name) for name in NAMES}
    columns |= {"meta/episodes/chunk_index": pa.int64(), "meta/episodes/file_index": pa.int64()}
    return pa.schema(list(columns.items()))


def without_place(row: EpisodeRow) -> EpisodeRow:
    """Return the row without what ``place_row`` adds, ready to be placed in another dataset."""
    dropped = ("episode_index", "dataset_from_index", "dataset_to_index", "meta/")
    stats = tuple(f"stats/{key}/" for key in BOOKKEEPING)
    return {name: value for name, value in row.items() if not name.startswith((*dropped, *stats))}


def _stat_type(picture: bool, name: str) -> pa.DataType:
    if name == "count":
        return pa.list_(pa.int64())
    number = pa.list_(pa.float64())
    return pa.list_(pa.list_(number)) if picture else number
