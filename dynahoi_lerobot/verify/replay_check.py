"""Replay check: make episodes again from recipe and seed, and compare every column and picture with the stored ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.dataset.episode_arrays import content_arrays
from dynahoi_lerobot.dataset.statistics import picture_histogram, sampled_frames
from dynahoi_lerobot.dataset.episode_table import row_histogram
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.features import IMAGE_PREFIX, episode_features
from dynahoi_lerobot.verify.checks.base import CheckedDataset, Finding, stratified

if TYPE_CHECKING:
    from dynahoi_lerobot.rollout.replay import Resimulate

TOLERANCE = 1e-5
"""Greatest difference of a number [its unit], for replays on another processor; on one machine they are equal."""

PICTURE_TOLERANCE = 8.0
"""Greatest mean difference of a picture [levels of 255]: video is lossy."""
SWAP_FACTOR, SWAP_MARGIN = 0.7, 0.75
"""A stored picture shows another frame if it is nearer to that frame's rendering than to its own by both: a share of
the difference, and so many levels."""
HISTOGRAM_TOLERANCE = 0.001
"""Share of pixels whose level another renderer may change in the stored histogram."""


def compare_replays(dataset: CheckedDataset, resimulate: Resimulate, count: int) -> Iterator[Finding]:
    """Make ``count`` episodes again, stratified by kind of motion, and yield what differs.

    Args:
        dataset: the dataset under test.
        resimulate: makes the episode of a seed.
        count: how many episodes.
    """
    for index in stratified(dataset.rows, count):
        stored = dataset.episode(index)
        made = resimulate(stored.meta.seed)
        if made is None:
            yield Finding("replay", f"episode {index}: the expert does not manage seed {stored.meta.seed}")
            continue
        problems = (*_values(made, stored), *_arrays(made, stored), *_pictures(made, stored))
        yield from (Finding("replay", f"episode {index} replays to {problem}") for problem in problems)
        if stored.images:
            row = dataset.stats_rows[index]
            yield from (Finding("replay", f"episode {index} replays to {item}") for item in _histograms(made, row))


def _values(made: Episode, stored: Episode) -> Iterator[str]:
    """Yield facts about the episode that differ, strings and whole numbers exactly."""
    one = asdict(made.meta) | {"success": made.success, "stage": made.stage}
    other = asdict(stored.meta) | {"success": stored.success, "stage": stored.stage}
    yield from (f"{name} {one[name]!r}; stored is {other[name]!r}" for name in one if one[name] != other[name])


def _arrays(made: Episode, stored: Episode) -> Iterator[str]:
    """Yield columns that differ by more than the tolerance, with the first frame that does."""
    ones, others = _columns(made), _columns(stored)
    for key in sorted(ones.keys() | others.keys()):
        one, other = ones.get(key), others.get(key)
        if one is None or other is None or one.shape != other.shape:
            found, held = (None if x is None else x.shape for x in (one, other))
            yield f"{key} of shape {found}; stored is {held}"
            continue
        apart = np.abs(one.astype(float) - other).reshape(len(one), -1).max(axis=1)  # (T,)
        if not (worst := float(apart.max())) <= TOLERANCE:
            yield f"another {key} from frame {int((~(apart <= TOLERANCE)).argmax())} on, up to {worst:.2g} apart"


def _columns(episode: Episode) -> dict[str, np.ndarray]:
    tables = {feature.key: np.asarray(getattr(episode, feature.name)) for feature in episode_features()}
    return content_arrays(episode) | tables


def _pictures(made: Episode, stored: Episode) -> Iterator[str]:
    for view in sorted(made.images.keys() | stored.images.keys()):
        one, other = made.images.get(view), stored.images.get(view)
        if one is None or other is None or one.shape != other.shape:
            found, held = (None if x is None else x.shape for x in (one, other))
            yield f"pictures of {view} of shape {found}; stored is {held}"
            continue
        yield from (f"another picture of {view} {problem}" for problem in _frames(one, other))


def _frames(made: np.ndarray, stored: np.ndarray) -> Iterator[str]:
    """Yield the first stored picture that is not its frame's, (T, H, W, 3) each."""
    levels = np.stack([_apart(made, picture) for picture in stored])  # (T stored, T made)
    own, nearest = levels.diagonal(), levels.min(axis=1)
    wrong = own > PICTURE_TOLERANCE
    swapped = (nearest < SWAP_FACTOR * own) & (nearest < own - SWAP_MARGIN)
    if not (wrong | swapped).any():
        return
    frame = int((wrong | swapped).argmax())
    shows = f", which looks like frame {int(levels[frame].argmin())}" if swapped[frame] else ""
    yield f"at frame {frame}, {own[frame]:.1f} levels apart{shows}"


def _apart(pictures: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Return (T,) mean differences [levels] of (T, H, W, 3) pictures from one."""
    return np.abs(pictures.astype(np.int16) - picture.astype(np.int16)).mean(axis=(1, 2, 3))


def _histograms(made: Episode, row: dict) -> Iterator[str]:
    """Yield views whose stored histogram, taken before the video was encoded, is not that of the rendering."""
    for view, images in made.images.items():
        stored = row_histogram(row, IMAGE_PREFIX + view)
        found = picture_histogram(images[sampled_frames(len(images))])
        if np.abs(found - stored).sum() > 2 * HISTOGRAM_TOLERANCE * found.sum():
            yield f"another histogram of {view} than the episode table holds"
