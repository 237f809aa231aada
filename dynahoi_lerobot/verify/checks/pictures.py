"""The pictures can be decoded and are those that the episode's statistics were taken from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
from av.error import FFmpegError

from dynahoi_lerobot.dataset.episode_table import EpisodeRow, row_histogram
from dynahoi_lerobot.dataset.statistics import picture_histogram, sampled_frames
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns

LOSSY_LEVELS = 3.0
"""Greatest shift of a channel's mean through lossy compression [levels of 255]."""
LOSSY_SPREAD = 8.0
"""Greatest distance that lossy compression moves the levels of a channel, on average (earth mover's distance of the
histograms, in levels of 255; seen: 3.4 at 32 px, 5.0 at 16 px). PNG pictures give the stored histogram exactly."""


@CHECKS.register("pictures")
class Pictures(Check):
    """Decodes a stratified sample of episodes and compares their histograms with the stored ones."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield pictures that cannot be decoded or do not belong to the episode."""
        if row["episode_index"] not in dataset.sample or not dataset.pictures:
            return
        try:
            table = dataset.frames(row)
        except (OSError, ValueError) as error:
            yield f"the pictures of episode {row['episode_index']} cannot be decoded: {error}"
            return
        for key in dataset.pictures:
            yield from _view(dataset, row, table, key)


def _view(dataset: CheckedDataset, row: EpisodeRow, table: pa.Table, key: str) -> Iterator[str]:
    """Yield what is wrong with one view of an episode, whose frames are ``table``."""
    name = f"{key} of episode {row['episode_index']}"
    try:
        images = dataset.images(row, table, key)
    except (OSError, FFmpegError, ValueError) as error:
        yield f"{name} cannot be decoded: {error}"
        return
    if len(images) != row["length"]:
        yield f"{name} has {len(images)} pictures for {row['length']} frames"
        return
    stored = row_histogram(row, key)  # (3, 256)
    found = picture_histogram(images[sampled_frames(len(images))])
    yield from (
        f"{name} does not show what its statistics were taken from: {how}" for how in _differ(dataset, stored, found)
    )


def _differ(dataset: CheckedDataset, stored: np.ndarray, found: np.ndarray) -> Iterator[str]:
    """Yield how the (3, 256) counts of decoded pictures differ from the stored ones."""
    if not dataset.has_video:
        if (apart := int(np.abs(stored - found).sum()) // 2) > 0:
            yield f"{apart} pixels have other levels"
        return
    if (stored.sum(axis=1) != found.sum(axis=1)).any():
        yield f"they count {int(stored.sum()) // 3} pixels, the pictures have {int(found.sum()) // 3}"
        return
    moved = np.cumsum(found - stored, axis=1) / found.sum(axis=1, keepdims=True)  # (3, 256)
    if (shift := float(np.abs(moved.sum(axis=1)).max())) > LOSSY_LEVELS:
        yield f"mean levels differ by {shift:.0f} of 255"
    elif (spread := float(np.abs(moved).sum(axis=1).max())) > LOSSY_SPREAD:
        yield f"levels are spread otherwise, by {spread:.0f} of 255"
