"""Frames are 1/20 s apart."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


@CHECKS.register("timestamps")
class Timestamps(Check):
    """Checks that ``timestamp`` [s] is the frame's number divided by the frame rate, to the last bit."""

    of_the_format = True

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield the first wrong timestamp."""
        times = columns["timestamp"][:, 0]
        wanted = (np.arange(len(times)) / CONTROL_HZ).astype(np.float32)
        wrong = np.flatnonzero(times != wanted)
        if wrong.size:
            frame = int(wrong[0])
            yield (
                f"episode {row['episode_index']}, frame {frame}: timestamp is {times[frame]:.4f} s; at {CONTROL_HZ} Hz "
                f"it is {wanted[frame]:.4f} s"
            )
