"""The episode table: LeRobot's columns, then one column per fact about the episode, and its arrays
below ``stats/``.

Facts are read by ``LeRobotDataset(..., episode_filter=lambda ep: ep["motion"] == "lob")`` and by
``ds.meta.episodes[i]["seed"]``. LeRobot does not load what is below ``stats/``, so privileged
arrays cost no training anything there; ``dataset.frame_column`` reads them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from typing import Any, get_type_hints

import numpy as np
import pyarrow as pa

from dynahoi_lerobot.core.episode import Episode, EpisodeMeta
from dynahoi_lerobot.core.features import Feature, episode_features
from dynahoi_lerobot.dataset.columns import (
    BOOKKEEPING,
    SCALARS,
    Features,
    bookkeeping_arrays,
    image_keys,
    is_list,
    is_number,
    numeric_keys,
)  # fmt: skip
from dynahoi_lerobot.dataset.statistics import NAMES, Stats, table_stats

EpisodeRow = dict[str, Any]

FACTS = {
    field.name: pa.string() if field.type is str else pa.int64() for field in fields(EpisodeMeta)
}
FACTS |= {"success": pa.bool_(), "stage": pa.string()}
"""Our columns that hold one value."""
FACT_TYPES = get_type_hints(EpisodeMeta) | {"success": bool, "stage": str, "tasks": tuple[str]}
"""What an episode needs to be copied; an edited dataset may lack it."""


def own_columns(episode: Episode, features: Iterable[Feature]) -> EpisodeRow:
    """Return our columns of an episode's row: its facts, and those of ``features`` that are in this
    table.
    """
    arrays = {f.key: _cells(getattr(episode, f.name), f) for f in features if f.in_episode_table}
    return (
        asdict(episode.meta) | {"success": bool(episode.success), "stage": episode.stage} | arrays
    )


def own_values(row: EpisodeRow) -> dict[str, Any]:
    """Return the attributes of an Episode that its row holds: undoes ``own_columns``.

    Raises:
        KeyError: if a column is missing that every dataset has.
        ValueError: if an array by frame is not as long as the episode.
    """
    held = [f for f in episode_features() if not f.derived and (f.key in row or not f.optional)]
    meta = EpisodeMeta(**{field.name: row[field.name] for field in fields(EpisodeMeta)})
    values = {f.name: _value(row[f.key], f) for f in held}
    for f in held:
        if f.per == "frame" and not f.constant and len(values[f.name]) != row["length"]:
            raise ValueError(
                f"{f.key} has {len(values[f.name])} rows; the episode has {row['length']} frames"
            )
    return {"meta": meta, "success": row["success"], "stage": row["stage"]} | values


def _cells(value: Any, feature: Feature) -> Any:
    """A number, or the elements of an array one after the other."""
    array = np.asarray(value, feature.dtype)
    return array.ravel().tolist() if array.ndim else array.item()


def _value(cells: Any, feature: Feature) -> Any:
    """The attribute of an Episode: a number, or an array of the feature's shape, of several where
    it has several.
    """
    array = np.array(cells, feature.dtype)
    if not array.ndim:
        return array.item()
    return array.reshape(feature.shape if feature.constant else (-1, *feature.shape))


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


def row_schema(features: Features, columns: Sequence[Feature]) -> pa.Schema:
    """Return the schema of the episode files: of ``columns``, those that are in this table
    count.
    """
    images = image_keys(features)
    videos = [key for key in images if features[key]["dtype"] == "video"]
    types: dict[str, pa.DataType] = {"episode_index": pa.int64(), "tasks": pa.list_(pa.string())}
    types |= {"length": pa.int64(), "data/chunk_index": pa.int64(), "data/file_index": pa.int64()}
    types |= {"dataset_from_index": pa.int64(), "dataset_to_index": pa.int64()}
    types |= video_columns(videos, dict.fromkeys(("chunk_index", "file_index"), pa.int64()))
    types |= video_columns(videos, dict.fromkeys(("from_timestamp", "to_timestamp"), pa.float64()))
    types |= FACTS | {
        feature.key: _type(feature) for feature in columns if feature.in_episode_table
    }
    for key in [*images, *numeric_keys(features)]:
        types |= {f"stats/{key}/{name}": _stat_type(key in images, name) for name in NAMES}
    types |= {"meta/episodes/chunk_index": pa.int64(), "meta/episodes/file_index": pa.int64()}
    return pa.schema(list(types.items()))


def fits_column(found: pa.DataType, wanted: pa.DataType) -> bool:
    """Tell whether a column may be of another type than ``row_schema`` says.

    LeRobot's tools write other numeric and list types, and null where an episode from elsewhere has
    no value.
    """
    if pa.types.is_null(found):
        return True
    if is_list(found) and is_list(wanted):
        return fits_column(found.value_type, wanted.value_type)
    if pa.types.is_string(wanted):
        return found in (pa.string(), pa.large_string())
    return is_number(found) and is_number(wanted)


def _type(feature: Feature) -> pa.DataType:
    scalar = SCALARS[feature.dtype]
    return scalar if feature.constant and not feature.shape else pa.list_(scalar)


def _stat_type(image: bool, name: str) -> pa.DataType:
    if name == "count":
        return pa.list_(pa.int64())
    number = pa.list_(pa.float64())
    return pa.list_(pa.list_(number)) if image else number


def without_place(row: EpisodeRow) -> EpisodeRow:
    """Return the row without what ``place_row`` adds, ready to be placed in another dataset."""
    dropped = (
        "episode_index",
        "dataset_from_index",
        "dataset_to_index",
        "meta/",
        "data/",
        "videos/",
    )
    stats = tuple(f"stats/{key}/" for key in BOOKKEEPING)
    return {name: value for name, value in row.items() if not name.startswith((*dropped, *stats))}
