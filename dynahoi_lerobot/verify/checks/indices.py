"""Frames and episodes are numbered without gaps, and every table agrees about where an episode lies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


@CHECKS.register("indices")
class Indices(Check):
    """Checks ``episode_index``, ``frame_index``, ``index`` and the ranges in the episode table."""

    of_the_format = True

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield gaps and overlaps between episodes."""
        start = 0
        for position, row in enumerate(dataset.rows):
            if row["episode_index"] != position:
                yield f"row {position} of the episode table is numbered {row['episode_index']}"
            span = (row["dataset_from_index"], row["dataset_to_index"])
            if span != (start, start + row["length"]):
                yield f"episode {position} spans frames {span}; {(start, start + row['length'])} follows"
            start = span[1]
        seen = {row["episode_index"] for row, _ in dataset.each_episode()}
        for row in dataset.rows:
            if row["episode_index"] not in seen:
                yield f"episode {row['episode_index']} has no frames in the data files"

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield wrong numbers within an episode."""
        number, frames = row["episode_index"], len(columns["index"])
        if frames != row["length"]:
            yield f"episode {number} has {frames} frames in a row; the episode table says {row['length']}"
        for key, first in (("frame_index", 0), ("index", row["dataset_from_index"])):
            wrong = np.flatnonzero(columns[key][:, 0] != first + np.arange(frames))
            if wrong.size:
                frame = int(wrong[0])
                found, wanted = int(columns[key][frame, 0]), first + frame
                yield f"episode {number}, frame {frame}: {key} is {found}; it is {wanted}"
        if dataset.data_path(row) not in dataset.data_files():
            yield f"episode {number} is said to lie in {dataset.data_path(row).name}, which does not exist"
