"""The pictures can be decoded and are those that the episode's statistics were taken from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
from av.error import FFmpegError

from dynahoi_lerobot.dataset.episode_table import EpisodeRow, row_stats
from dynahoi_lerobot.dataset.statistics import picture_histogram, picture_stats, sampled_frames
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns

LOSSY_LEVELS = 3.0
"""Greatest shift of a channel's mean through lossy compression [levels of 255]."""


@CHECKS.register("pictures")
class Pictures(Check):
    """Decodes a stratified sample of episodes and compares the mean level of each channel."""

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
    sample = images[sampled_frames(len(images))]
    found = picture_stats(picture_histogram(sample), len(sample))["mean"]
    expected = row_stats(row, key)["mean"]
    if (shift := float(np.abs(found - expected).max()) * 255) > LOSSY_LEVELS:
        yield f"{name} does not show what its statistics were taken from: mean levels differ by {shift:.0f} of 255"
