"""Robust-range outliers (Appendix "Post-processing"): commands far outside [q01, q99] of the whole dataset."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynahoi_lerobot.dataset.paths import STATS_PATH
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.subset import copy_subset
from dynahoi_lerobot.verify.checks.base import CheckedDataset

MARGIN = 1.0
"""Default margin on either side, in widths of the robust range."""


@dataclass(frozen=True)
class Outlier:
    """An episode's worst excursion.

    Attributes:
        episode: its index.
        column: the column and the name of the dimension.
        frames: how many frames are outside.
        worst: the value furthest out [m or rad].
        low: least value allowed [m or rad].
        high: greatest value allowed [m or rad].
    """

    episode: int
    column: str
    frames: int
    worst: float
    low: float
    high: float

    def __str__(self) -> str:
        """Say it in a sentence."""
        allowed = f"{self.low:.3f} to {self.high:.3f}"
        return f"episode {self.episode}: {self.column} is {self.worst:.3f} in {self.frames} frames; {allowed} is usual"


def find_outliers(root: Path, margin: float = MARGIN, column: str = "action") -> list[Outlier]:
    """Find episodes that leave ``[q01 - margin * width, q99 + margin * width]``, width being ``q99 - q01``.

    Args:
        root: the dataset's folder.
        margin: widths of the robust range that are allowed beyond it.
        column: which column to look at.

    Returns:
        At most one outlier per episode, its worst.

    Raises:
        ValueError: if the margin is negative.
    """
    if margin < 0:
        raise ValueError(f"the margin is {margin}; it must be 0 or more")
    dataset = CheckedDataset(root, 0)
    stats = json.loads((root / STATS_PATH).read_text())[column]
    q01, q99 = np.array(stats["q01"]), np.array(stats["q99"])
    width = q99 - q01
    low, high = q01 - margin * width, q99 + margin * width
    names = dataset.features[column]["names"]
    found = []
    for row, columns in dataset.each_episode():
        values = columns[column].astype(np.float64)
        beyond = np.maximum(low - values, values - high)  # (T, D), positive outside
        frame, axis = np.unravel_index(int(beyond.argmax()), beyond.shape)
        # Rounding of float32 is no excursion.
        if beyond[frame, axis] > 1e-6:
            frames, worst = int((beyond[:, axis] > 0).sum()), float(values[frame, axis])
            name = f"{column}.{names[axis]}"
            found.append(Outlier(row["episode_index"], name, frames, worst, float(low[axis]), float(high[axis])))
    return found


def reject_outliers(root: Path, output: Path, margin: float = MARGIN) -> list[Outlier]:
    """Copy the dataset without its outliers to ``output``; return what was left out."""
    outliers = find_outliers(root, margin)
    rejected = {outlier.episode for outlier in outliers}
    copy_subset(root, output, [index for index in range(Store(root).episodes) if index not in rejected])
    return outliers
