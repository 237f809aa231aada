"""The pictures can be decoded and are those that the episode's statistics were taken from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
from av.error import FFmpegError

from dynahoi_lerobot.dataset.episode_table import Row, row_stats
from dynahoi_lerobot.dataset.statistics import picture_histogram, picture_stats, sampled_frames
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, Columns, Evidence

LOSSY_LEVELS = 3.0
"""Mean levels of a channel may shift by so much of 255 through lossy compression."""


@CHECKS.register("pictures")
class Pictures(Check):
    """Decodes a stratified sample of episodes and compares the mean level of each channel."""

    def episode(self, evidence: Evidence, row: Row, columns: Columns) -> Iterator[str]:
        """Yield pictures that cannot be decoded or do not belong to the episode."""
        if row["episode_index"] not in evidence.sample or not evidence.pictures:
            return
        try:
            table = evidence.frames(row)
        except (OSError, ValueError) as error:
            yield f"the pictures of episode {row['episode_index']} cannot be decoded: {error}"
            return
        for key in evidence.pictures:
            yield from _view(evidence, row, table, key)


def _view(evidence: Evidence, row: Row, table: pa.Table, key: str) -> Iterator[str]:
    """Yield what is wrong with one view of an episode, whose frames are ``table``."""
    name = f"{key} of episode {row['episode_index']}"
    try:
        images = evidence.images(row, table, key)
    except (OSError, FFmpegError, ValueError) as error:
        yield f"{name} cannot be decoded: {error}"
        return
    if len(images) != row["length"]:
        yield f"{name} has {len(images)} pictures for {row['length']} frames"
        return
    sample = images[sampled_frames(len(images))]
    found = picture_stats(picture_histogram(sample), len(sample))["mean"]
    promised = row_stats(row, key)["mean"]
    if (shift := float(np.abs(found - promised).max()) * 255) > LOSSY_LEVELS:
        yield f"{name} does not show what its statistics were taken from: mean levels differ by {shift:.0f} of 255"
