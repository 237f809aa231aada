"""Markdown tables of the dataset card."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import pyarrow.parquet as pq

from dynahoi_lerobot.core.features import (
    FEATURES,
    IMAGE_PREFIX,
    Feature,
    episode_features,
    image_feature,
    moved_features,
)
from dynahoi_lerobot.dataset.columns import Features
from dynahoi_lerobot.dataset.language import LANGUAGE

LEROBOTS = {
    "timestamp": ("s", "time of the frame in its episode"),
    "frame_index": ("1", "number of the frame in its episode"),
    "episode_index": ("1", "number of the episode"),
    "index": ("1", "number of the frame in the dataset"),
    LANGUAGE: ("s", "subtasks, each with its timestamp: the same rows in every frame of an episode"),
    "task_index": ("1", "number of the instruction in `meta/tasks.parquet`"),
}
"""Unit and meaning of LeRobot's own columns."""


def frame_table(features: Features) -> str:
    """Return the table of the frame table's columns, with units."""
    rows = [
        [f"`{key}`", entry["dtype"], _shape(entry["shape"]), *_unit_and_meaning(key, entry["shape"])]
        for key, entry in features.items()
    ]
    return markdown(["column", "dtype", "shape", "unit", "meaning"], rows)


def episode_table(features: Features) -> str:
    """Return the table of the episode table's arrays, with units; (n, ...) has a row per frame, solid or attempt."""
    arrays = (*episode_features(), *moved_features(features))
    rows = [[f"`{f.key}`", f.dtype, _episode_shape(f), f.unit, f.meaning] for f in arrays]
    return markdown(["column", "dtype", "shape", "unit", "meaning"], rows)


def counts(files: Iterable[Path], column: str) -> tuple[str, int]:
    """Count the episodes and successes of every value of a column of the episode table.

    Args:
        files: the files of the episode table.
        column: ``motion`` or ``object``.

    Returns:
        The table and the number of successes of all episodes.
    """
    episodes, successes = Counter[str](), Counter[str]()
    for path in files:
        table = pq.read_table(path, columns=[column, "success"])
        for name, success in zip(table[column].to_pylist(), table["success"].to_pylist(), strict=True):
            episodes[name] += 1
            successes[name] += bool(success)
    rows = [[name, str(count), str(successes[name])] for name, count in sorted(episodes.items())]
    return markdown([column, "episodes", "successes"], rows), successes.total()


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _unit_and_meaning(key: str, shape: Sequence[int]) -> tuple[str, str]:
    if key in LEROBOTS:
        return LEROBOTS[key]
    if key.startswith(IMAGE_PREFIX):
        feature = image_feature(key.removeprefix(IMAGE_PREFIX), shape[0])
    else:
        feature = next(feature for feature in FEATURES.values() if feature.key == key)
    return feature.unit, feature.meaning


def _episode_shape(feature: Feature) -> str:
    return _shape(feature.shape if feature.constant else ("n", *feature.shape)) or "1"


def _shape(sides: Sequence[object]) -> str:
    return " x ".join(map(str, sides))
