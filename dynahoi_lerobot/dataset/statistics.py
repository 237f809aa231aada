"""Statistics in LeRobot's schema: min, max, mean, std, count and five quantiles, of columns and of
images.

LeRobot averages the quantiles of episodes, so its ``q01`` of a column depends on how frames were
grouped. Ours is taken over all frames: the smallest value with at least a share q of all values at
or below it.
"""

from collections.abc import Sequence

import cv2
import numpy as np

Stats = dict[str, np.ndarray]

SHARES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
NAMES = ("min", "max", "mean", "std", "count", *SHARES)
"""LeRobot's statistics, in its order."""

LEVELS = np.arange(256) / 255
LARGE_IMAGE = 300
SMALL_IMAGE = 150
"""LeRobot thins images of LARGE_IMAGE pixels or more to about SMALL_IMAGE before it counts."""
EXACT_FRAMES = 100
"""OpenCV counts in single precision, exactly up to 2 ** 24; so many thinned images have fewer
pixels."""


def column_stats(values: np.ndarray) -> Stats:
    """Return the statistics of a (T, D) array of numbers or bool along time, each (D,) float64."""
    values = values.astype(np.float32) if values.dtype == bool else values
    quantiles = np.quantile(values, list(SHARES.values()), axis=0, method="inverted_cdf")  # (5, D)
    return {
        "min": values.min(axis=0).astype(float),
        "max": values.max(axis=0).astype(float),
        "mean": values.mean(axis=0, dtype=float),
        "std": values.std(axis=0, dtype=float),
        "count": np.array([len(values)]),
        **{name: found.astype(float) for name, found in zip(SHARES, quantiles, strict=True)},
    }


def table_stats(arrays: dict[str, np.ndarray]) -> dict[str, Stats]:
    """Return ``column_stats`` of several (T, D) or (T,) arrays at once: one pass over one wide
    matrix.
    """
    wide = {key: values.reshape(len(values), -1) for key, values in arrays.items()}  # (T, D)
    stats = column_stats(
        np.concatenate(list(wide.values()), axis=1, dtype=np.float64, casting="unsafe")
    )
    edges = np.cumsum([0, *(values.shape[1] for values in wide.values())])
    return {
        key: {
            name: value if name == "count" else value[start:stop] for name, value in stats.items()
        }
        for key, start, stop in zip(wide, edges[:-1], edges[1:], strict=True)
    }


def image_stats(images: np.ndarray) -> Stats:
    """Return the statistics of an episode's images (T, H, W, 3) uint8 RGB, in levels from 0 to 1,
    each (3, 1, 1).

    As LeRobot samples them, up to 100 frames all count, of more about ``frames ** 0.75``.
    """
    size = max(images.shape[1:3])
    step = size // SMALL_IMAGE if size >= LARGE_IMAGE else 1
    n_sampled = max(min(len(images), 100), min(int(len(images) ** 0.75), 10_000))
    sampled = np.round(np.linspace(0, len(images) - 1, n_sampled)).astype(int)
    images = images[sampled, ::step, ::step]
    counts = level_counts(images)
    share = counts / counts.sum(axis=1, keepdims=True)
    below = np.cumsum(counts, axis=1)
    mean = share @ LEVELS
    found = {
        "min": [LEVELS[channel.nonzero()[0][0]] for channel in counts],
        "max": [LEVELS[channel.nonzero()[0][-1]] for channel in counts],
        "mean": mean,
        "std": np.sqrt((share * (LEVELS - mean[:, None]) ** 2).sum(axis=1)),
        **{
            name: LEVELS[(below < part * below[:, -1:]).sum(axis=1)]
            for name, part in SHARES.items()
        },
    }
    shaped = {name: np.reshape(value, (3, 1, 1)) for name, value in found.items()}
    return {name: np.array([len(images)]) if name == "count" else shaped[name] for name in NAMES}


def level_counts(images: np.ndarray) -> np.ndarray:
    """Return how often each channel of images (T, H, W, 3) has each of its 256 levels, (3, 256)
    int64.
    """
    counts = np.zeros((3, 256), np.int64)
    for first in range(0, len(images), EXACT_FRAMES):
        block = np.ascontiguousarray(images[first : first + EXACT_FRAMES]).reshape(
            -1, images.shape[2], 3
        )
        counts += [
            cv2.calcHist([block], [c], None, [256], [0, 256]).ravel().astype(np.int64)
            for c in range(3)
        ]
    return counts


def pooled(episodes: Sequence[Stats]) -> Stats:
    """Return the statistics of all episodes' images together; their quantiles are averaged, as
    LeRobot does.
    """
    stacked = {name: np.stack([stats[name] for stats in episodes]) for name in NAMES}
    count = stacked["count"].astype(float)  # (E, 1)
    weight = (count / count.sum()).reshape(-1, 1, 1, 1)
    average = {name: (weight * stacked[name]).sum(axis=0) for name in ("mean", *SHARES)}
    spread = stacked["std"] ** 2 + (stacked["mean"] - average["mean"]) ** 2
    found = average | {"min": stacked["min"].min(axis=0), "max": stacked["max"].max(axis=0)}
    found |= {"std": np.sqrt((weight * spread).sum(axis=0)), "count": stacked["count"].sum(axis=0)}
    return {name: found[name] for name in NAMES}
