"""The episode table: LeRobot's columns, then one plain column per fact about the episode.

They are read by ``LeRobotDataset(..., episode_filter=lambda ep: ep["motion"] == "lob")`` and by
``ds.meta.episodes[i]["seed"]``.
"""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import pyarrow as pa

from dynahoi_lerobot.core.episode import Episode, EpisodeMeta
from dynahoi_lerobot.core.features import EPISODE_TABLE_PREFIX, Feature, episode_features, moved_features
from dynahoi_lerobot.dataset.columns import BOOKKEEPING, Features, bookkeeping_arrays, image_keys, numeric_keys
from dynahoi_lerobot.dataset.statistics import LEVELS, NAMES, Stats, table_stats

EpisodeRow = dict[str, Any]

HISTOGRAM = "stats/histogram_of:"
"""Before an image's key: column with the 3 x 256 counts of the episode's sample, from which datasets sum theirs."""

_META = {field.name: pa.string() if field.type == "str" else pa.int64() for field in fields(EpisodeMeta)}
_SCALARS = {"float32": pa.float32(), "bool": pa.bool_()}


def _types(features: Iterable[Feature]) -> dict[str, pa.DataType]:
    return {f.key: _SCALARS[f.dtype] if f.constant and not f.shape else pa.list_(_SCALARS[f.dtype]) for f in features}


_OWN = _META | {"success": pa.bool_(), "stage": pa.string()} | _types(episode_features())
OWN_COLUMNS = tuple(_OWN)
"""Our columns of the episode table."""

ARRAY_COLUMNS = tuple(feature.key for feature in (*episode_features(), *moved_features()))
"""Columns of the episode table that are arrays of an Episode, also those that most datasets have in the frame table."""


def own_columns(episode: Episode, held: Container[str]) -> EpisodeRow:
    """Return our columns of the row of an episode whose frame table has the columns ``held``."""
    arrays = {f.key: _cells(getattr(episode, f.name), f) for f in (*episode_features(), *moved_features(held))}
    return asdict(episode.meta) | {"success": bool(episode.success), "stage": episode.stage} | arrays


def own_values(row: EpisodeRow) -> dict[str, Any]:
    """Return the attributes of an Episode that its row holds: undoes ``own_columns``."""
    held = (*episode_features(), *_moved(row))
    arrays = {f.name: _value(row[f.key], f) for f in held if not f.derived}
    meta = EpisodeMeta(**{name: row[name] for name in _META})
    return {"meta": meta, "success": row["success"], "stage": row["stage"]} | arrays


def moved_columns(row: EpisodeRow) -> dict[str, np.ndarray]:
    """Return the columns that the row holds for the frame table, (T, D) each, by the keys that they have there."""
    frames, columns = row["length"], {}
    for feature in _moved(row):
        value = np.array(row[feature.key], feature.dtype).reshape(-1, *feature.column_shape)  # (T or 1, D)
        columns[feature.key.removeprefix(EPISODE_TABLE_PREFIX)] = value.repeat(frames, 0) if feature.constant else value
    return columns


def _moved(row: EpisodeRow) -> list[Feature]:
    return [feature for feature in moved_features() if feature.key in row]


def _cells(value: Any, feature: Feature) -> Any:
    """A number, or the elements of an array one after the other."""
    array = np.asarray(value, feature.dtype)
    return array.ravel().tolist() if array.ndim else array.item()


def _value(cells: Any, feature: Feature) -> Any:
    """The attribute of an Episode: a number, or an array of the feature's shape, of several where it has several."""
    array = np.array(cells, feature.dtype)
    if not array.ndim:
        return array.item()
    return array.reshape(feature.shape if feature.constant else (-1, *feature.shape))


def stats_columns(stats: dict[str, Stats]) -> EpisodeRow:
    """Return ``stats/<key>/<name>`` columns."""
    return {f"stats/{key}/{name}": stats[key][name].tolist() for key in stats for name in NAMES}


def row_histogram(row: EpisodeRow, key: str) -> np.ndarray:
    """Return the (3, 256) counts of the episode's sampled images."""
    return np.array(row[HISTOGRAM + key], np.int64).reshape(3, LEVELS)


def video_columns(keys: Iterable[str], place: dict[str, Any]) -> EpisodeRow:
    """Return ``videos/<key>/<name>`` columns; the images of an episode lie at the same place for every key."""
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
    images = image_keys(features)
    videos = [key for key in images if features[key]["dtype"] == "video"]
    columns: dict[str, pa.DataType] = {"episode_index": pa.int64(), "tasks": pa.list_(pa.string())}
    columns |= {"length": pa.int64(), "data/chunk_index": pa.int64(), "data/file_index": pa.int64()}
    columns |= {"dataset_from_index": pa.int64(), "dataset_to_index": pa.int64()}
    columns |= video_columns(videos, dict.fromkeys(("chunk_index", "file_index"), pa.int64()))
    columns |= video_columns(videos, dict.fromkeys(("from_timestamp", "to_timestamp"), pa.float64()))
    columns |= _OWN | _types(moved_features(features))
    columns |= {HISTOGRAM + key: pa.list_(pa.int64()) for key in images}
    for key in [*images, *numeric_keys(features)]:
        columns |= {f"stats/{key}/{name}": _stat_type(key in images, name) for name in NAMES}
    columns |= {"meta/episodes/chunk_index": pa.int64(), "meta/episodes/file_index": pa.int64()}
    return pa.schema(list(columns.items()))


def without_place(row: EpisodeRow) -> EpisodeRow:
    """Return the row without what ``place_row`` adds, ready to be placed in another dataset."""
    dropped = ("episode_index", "dataset_from_index", "dataset_to_index", "meta/")
    stats = tuple(f"stats/{key}/" for key in BOOKKEEPING)
    return {name: value for name, value in row.items() if not name.startswith((*dropped, *stats))}


def _stat_type(image: bool, name: str) -> pa.DataType:
    if name == "count":
        return pa.list_(pa.int64())
    number = pa.list_(pa.float64())
    return pa.list_(pa.list_(number)) if image else number
