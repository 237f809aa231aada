"""Outliers (Appendix "Post-processing"): episodes that leave the robust range of a column of the whole dataset."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynahoi_lerobot.dataset.columns import content_keys
from dynahoi_lerobot.dataset.paths import STATS_PATH
from dynahoi_lerobot.verify.checks.base import CheckedDataset

MARGIN = 1.0
"""Default margin on either side, in widths of the robust range."""

ROUNDING = 1e-6
"""Excursions up to this [unit of the column] are rounding of float32."""


@dataclass(frozen=True)
class Outlier:
    """An episode's greatest excursion from the allowed range.

    Attributes:
        episode: its index.
        column: the column and the name of the dimension.
        frames: how many frames leave the range in this dimension.
        worst: the value furthest outside, in the column's unit.
        low: least value allowed.
        high: greatest value allowed.
    """

    episode: int
    column: str
    frames: int
    worst: float
    low: float
    high: float

    def __str__(self) -> str:
        """Return a sentence that names episode, dimension, value and range."""
        count = f"{self.frames} frame" + "s" * (self.frames != 1)
        allowed = f"{self.low:.3f} to {self.high:.3f}"
        return f"episode {self.episode}: {self.column} reaches {self.worst:.3f}, outside {allowed} in {count}"


def find_outliers(root: Path, margin: float = MARGIN, column: str = "action") -> list[Outlier]:
    """Find episodes that leave ``[q01 - margin * width, q99 + margin * width]``, width being ``q99 - q01``.

    Args:
        root: the dataset's folder.
        margin: widths of the robust range that are allowed beyond it.
        column: key of the (T, D) column to look at.

    Returns:
        At most one outlier per episode, its greatest excursion. NaN and infinity are excursions.

    Raises:
        FileNotFoundError: if ``root`` holds no dataset.
        ValueError: if the margin is negative or not finite, there is no such column, or one in a hundred of its values
            is not finite.
    """
    if not 0 <= margin < np.inf:
        raise ValueError(f"the margin is {margin}; it must be a finite number, 0 or more")
    dataset = CheckedDataset(root, 0)
    if column not in (known := content_keys(dataset.features)):
        raise ValueError(f"there is no column {column!r}; known: {', '.join(known)}")
    low, high = _allowed_range(root, margin, column)
    return list(_outliers(dataset, column, low, high))


def _allowed_range(root: Path, margin: float, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the (D,) least and greatest values allowed."""
    stats = json.loads((root / STATS_PATH).read_text())[column]
    q01, q99 = np.array(stats["q01"]), np.array(stats["q99"])
    if not np.isfinite([q01, q99]).all():
        raise ValueError(f"{column} is often not finite, so it has no robust range; see `dynahoi verify {root}`")
    return q01 - margin * (q99 - q01), q99 + margin * (q99 - q01)


def _outliers(dataset: CheckedDataset, column: str, low: np.ndarray, high: np.ndarray) -> Iterator[Outlier]:
    names = dataset.features[column]["names"] or range(len(low))
    for row, columns in dataset.each_episode():
        values = columns[column].astype(np.float64)
        beyond = np.nan_to_num(np.maximum(low - values, values - high), nan=np.inf)  # (T, D), positive outside
        frame, axis = np.unravel_index(int(beyond.argmax()), beyond.shape)
        if beyond[frame, axis] > ROUNDING:
            frames, worst = int((beyond[:, axis] > ROUNDING).sum()), float(values[frame, axis])
            name = f"{column}.{names[axis]}"
            yield Outlier(row["episode_index"], name, frames, worst, float(low[axis]), float(high[axis]))
