"""Statistics of columns and images, in LeRobot's schema: min, max, mean, std, count and five quantiles."""

from __future__ import annotations

from typing import Any

import numpy as np
from PIL import Image

from dynahoi_lerobot.dataset.quantiles import sorted_quantiles, weighted_quantiles

Stats = dict[str, np.ndarray]

NAMES = ("min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99")
"""LeRobot's statistics, in its order."""

LEVELS = 256
LARGE_IMAGE = 300
SMALL_IMAGE = 150
"""LeRobot thins images of LARGE_IMAGE pixels or more to about SMALL_IMAGE before it counts."""


def column_stats(values: np.ndarray) -> Stats:
    """Return the statistics of a (T, D) array along time, each (D,), computed in float64."""
    values = np.asarray(values, np.float64)
    return {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        "count": np.array([len(values)]),
        **sorted_quantiles(np.sort(values, axis=0)),
    }


def table_stats(arrays: dict[str, np.ndarray]) -> dict[str, Stats]:
    """Return ``column_stats`` of several (T, D) or (T,) arrays at once: one pass over one wide matrix."""
    wide = {key: values.reshape(len(values), -1) for key, values in arrays.items()}  # (T, D)
    stats = column_stats(np.concatenate(list(wide.values()), axis=1, dtype=np.float64, casting="unsafe"))
    edges = np.cumsum([0, *(values.shape[1] for values in wide.values())])
    return {
        key: {name: value if name == "count" else value[start:stop] for name, value in stats.items()}
        for key, start, stop in zip(wide, edges[:-1], edges[1:], strict=True)
    }


def sampled_frames(frames: int) -> np.ndarray:
    """Return the frames whose images LeRobot counts: all up to 100, then about ``frames ** 0.75``."""
    count = max(min(frames, 100), min(int(frames**0.75), 10_000))
    return np.round(np.linspace(0, frames - 1, count)).astype(int)


def picture_histogram(images: np.ndarray) -> np.ndarray:
    """Count the levels of each channel.

    Args:
        images: (N, H, W, 3) uint8 RGB.

    Returns:
        (3, 256) int64.
    """
    size = max(images.shape[1:3])
    step = size // SMALL_IMAGE if size >= LARGE_IMAGE else 1
    images = np.ascontiguousarray(images[:, ::step, ::step])
    number, height, width, _ = images.shape
    # One tall image lets Pillow count at memory speed.
    tall = Image.frombuffer("RGB", (width, number * height), images, "raw", "RGB", 0, 1)
    return np.array(tall.histogram(), np.int64).reshape(3, LEVELS)  # (3, 256)


def picture_stats(histogram: np.ndarray, count: int) -> Stats:
    """Return the exact statistics of ``count`` images from their (3, 256) counts, (3, 1, 1) in 0-1."""
    levels = np.arange(LEVELS) / (LEVELS - 1)
    total = histogram.sum(axis=1)
    mean = histogram @ levels / total
    spread = (levels - mean[:, None]) ** 2  # (3, 256)
    quantiles = [weighted_quantiles(levels, channel) for channel in histogram]
    seen = [levels[channel > 0] for channel in histogram]
    stats = {
        "min": np.array([values[0] for values in seen]),
        "max": np.array([values[-1] for values in seen]),
        "mean": mean,
        "std": np.sqrt((histogram * spread).sum(axis=1) / total),
        **{name: np.array([channel[name] for channel in quantiles]) for name in quantiles[0]},
    }
    shaped = {name: value.reshape(3, 1, 1) for name, value in stats.items()}
    return {name: np.array([count]) if name == "count" else shaped[name] for name in NAMES}


class Moments:
    """Mean, spread and range of many episodes, added one by one in the episodes' order."""

    def __init__(self) -> None:
        """Start with nothing."""
        self.count = 0
        self._mean: Any = 0.0
        self._square: Any = 0.0
        self._low: Any = np.inf
        self._high: Any = -np.inf

    def add(self, stats: Stats) -> None:
        """Add one episode's statistics (the pairwise update of Chan, Golub and LeVeque)."""
        added = int(stats["count"][0])
        total = self.count + added
        step = stats["mean"] - self._mean
        self._mean = self._mean + step * (added / total)
        self._square = self._square + stats["std"] ** 2 * added + step**2 * (self.count * added / total)
        self._low = np.minimum(self._low, stats["min"])
        self._high = np.maximum(self._high, stats["max"])
        self.count = total

    def stats(self, quantiles: Stats) -> Stats:
        """Return the statistics of everything added, with the given quantiles."""
        return {
            "min": self._low,
            "max": self._high,
            "mean": self._mean,
            "std": np.sqrt(self._square / self.count),
            "count": np.array([self.count]),
            **quantiles,
        }
