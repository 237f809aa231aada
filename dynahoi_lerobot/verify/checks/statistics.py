"""The statistics are those of the data."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from dynahoi_lerobot.dataset.columns import numeric_keys
from dynahoi_lerobot.dataset.dataset_stats import DatasetStats
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, row_histogram, row_stats
from dynahoi_lerobot.dataset.paths import HISTOGRAMS_PATH, STATS_PATH
from dynahoi_lerobot.dataset.statistics import NAMES, Stats, picture_stats, sampled_frames, table_stats
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns

ROUNDING = 1e-9
"""Relative difference that another order of summation may make."""


@CHECKS.register("statistics")
class Statistics(Check):
    """Computes every statistic again, of each episode and of the dataset."""

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield statistics of the whole dataset that differ."""
        stored = json.loads((dataset.root / STATS_PATH).read_text())
        summary = DatasetStats(dataset.features)
        for row in dataset.stats_rows:
            summary.add(row)
        found = summary.stats(dataset.root)
        for key in sorted(found.keys() | stored.keys()):
            yield from _differences(f"{STATS_PATH}: {key}", stored.get(key, {}), found.get(key, {}))
        if json.loads((dataset.root / HISTOGRAMS_PATH).read_text()) != summary.histograms(dataset.root, found):
            yield f"{HISTOGRAMS_PATH} does not count the dataset's states and actions"

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield statistics in the episode table that differ."""
        for key in dataset.pictures:
            found = picture_stats(row_histogram(row, key), len(sampled_frames(row["length"])))
            yield from _differences(f"episode {row['episode_index']}: {key}", row_stats(row, key), found)
        stored = {key: columns[key] for key in numeric_keys(dataset.features)}
        for key, stats in table_stats(stored).items():
            yield from _differences(f"episode {row['episode_index']}: {key}", row_stats(row, key), stats)


def _differences(where: str, stored: dict[str, Any], found: Stats) -> Iterator[str]:
    for name in NAMES:
        if name not in stored or name not in found:
            yield f"{where}/{name} is missing"
            return
        one, other = np.asarray(stored[name], float), np.asarray(found[name], float)
        if one.shape != other.shape or not np.allclose(one, other, ROUNDING, ROUNDING, equal_nan=False):
            yield f"{where}/{name} is {_short(one)}; the data give {_short(other)}"
            return


def _short(values: np.ndarray) -> str:
    flat = values.reshape(-1)
    text = ", ".join(f"{value:.6g}" for value in flat[:3])
    return f"[{text}{', ...' if flat.size > 3 else ''}]"
