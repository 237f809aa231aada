"""The statistics and histograms of a dataset, from its episode rows and one pass over its numeric columns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.dataset.columns import (
    BOOKKEEPING,
    Features,
    column_array,
    content_keys,
    image_keys,
    numeric_keys,
)
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, row_histogram, row_stats
from dynahoi_lerobot.dataset.statistics import (
    LEVELS,
    Moments,
    Stats,
    exact_quantiles,
    picture_stats,
    weighted_quantiles,
)

SHOWN = ("action", "observation.state")
BINS = 50


def histograms(
    read: Callable[[str], Iterable[np.ndarray]], features: Features, stats: dict[str, Stats]
) -> dict[str, dict[str, Any]]:
    """Count each dimension in equal bins between its least and its greatest value.

    Args:
        read: gives a column of the whole dataset, as (n, D) arrays.
        features: the feature table, for the names of the dimensions.
        stats: the dataset's statistics, for the ranges.

    Returns:
        Per key and dimension name: ``min`` and ``max`` in the column's unit, ``counts`` (BINS,).
    """
    result = {}
    for key in SHOWN:
        low, high = stats[key]["min"], stats[key]["max"]
        counts = np.zeros((len(low), BINS), np.int64)
        for batch in read(key):
            counts += _counts(batch, low, high)
        names = features[key]["names"]
        result[key] = {
            name: {"min": float(low[axis]), "max": float(high[axis]), "counts": counts[axis].tolist()}
            for axis, name in enumerate(names)
        }
    return result


def _counts(batch: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return (D, BINS) counts; a dimension that never changes falls into its first bin."""
    width = np.where(high > low, high - low, 1.0)
    position = np.nan_to_num((batch - low) / width)
    bins = np.clip(position * BINS, 0, BINS - 1).astype(int)  # (n, D)
    return np.stack([np.bincount(column, minlength=BINS) for column in bins.T])


class DatasetStats:
    """Collects episode rows, then computes ``stats.json`` and ``histograms.json``.

    Means and spreads come from the rows in their order, quantiles from the data files; neither depends on how the
    frames are divided into files.
    """

    def __init__(self, features: Features) -> None:
        """Start with no episode of these features."""
        self.features = features
        self._moments = {key: Moments() for key in numeric_keys(features)}
        self._task_frames: Counter[int] = Counter()
        self._lengths: list[int] = []
        self._pictures = Counter[str]()
        self._histograms = {key: np.zeros((3, LEVELS), np.int64) for key in image_keys(features)}

    def add(self, row: EpisodeRow) -> None:
        """Add one episode's row, with its statistics."""
        for key, moments in self._moments.items():
            moments.add(row_stats(row, key))
        for key in self._histograms:
            self._histograms[key] += row_histogram(row, key)
            self._pictures[key] += row[f"stats/{key}/count"][0]
        self._task_frames[int(row["stats/task_index/min"][0])] += row["length"]
        self._lengths.append(row["length"])

    def stats(self, root: Path) -> dict[str, Stats]:
        """Return the statistics by key; the data files below ``root`` are read for the quantiles."""
        quantiles = self._content_quantiles(root) | self._bookkeeping_quantiles()
        pictures = {key: picture_stats(counts, self._pictures[key]) for key, counts in self._histograms.items()}
        return pictures | {key: moments.stats(quantiles[key]) for key, moments in self._moments.items()}

    def histograms(self, root: Path, stats: dict[str, Stats]) -> dict[str, Any]:
        """Return the histograms of state and action, in the ranges of ``stats``."""
        return histograms(lambda key: numeric_batches(root, [key]), self.features, stats)

    def _content_quantiles(self, root: Path) -> dict[str, Stats]:
        keys = content_keys(self.features)
        edges = np.cumsum([0, *(self.features[key]["shape"][0] for key in keys)])
        wide = exact_quantiles(lambda: numeric_batches(root, keys))
        return {
            key: {name: value[start:stop].astype(np.float64) for name, value in wide.items()}
            for key, start, stop in zip(keys, edges[:-1], edges[1:], strict=True)
        }

    def _bookkeeping_quantiles(self) -> dict[str, Stats]:
        """Compute the quantiles of LeRobot's own columns from the lengths alone."""
        lengths, tasks = np.array(self._lengths), sorted(self._task_frames)
        frame_index, total = np.arange(lengths.max()), int(lengths.sum())
        present = len(lengths) - np.cumsum(np.bincount(lengths))[:-1]  # episodes that reach each frame index
        weights = {
            "timestamp": ((frame_index / CONTROL_HZ).astype(np.float32), present),
            "frame_index": (frame_index, present),
            "episode_index": (np.arange(len(lengths)), lengths),
            "index": (np.arange(total), np.ones(total, np.int64)),
            "task_index": (np.array(tasks), np.array([self._task_frames[task] for task in tasks])),
        }
        return {
            key: {name: np.array([value]) for name, value in weighted_quantiles(*weights[key]).items()}
            for key in BOOKKEEPING
        }


def numeric_batches(root: Path, keys: list[str]) -> Iterator[np.ndarray]:
    """Yield the given columns of each data file side by side, (n, D) float32."""
    for path in sorted((root / "data").glob("*/*.parquet")):
        table = pq.read_table(path, columns=keys)
        columns = [column_array(table, key) for key in keys]
        yield np.concatenate(columns, axis=1, dtype=np.float32, casting="unsafe")
