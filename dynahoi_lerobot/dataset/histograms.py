"""Histograms of every dimension of state and action, to see scale and saturation (Appendix "Post-processing")."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from dynahoi_lerobot.dataset.columns import Features
from dynahoi_lerobot.dataset.statistics import Stats

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
