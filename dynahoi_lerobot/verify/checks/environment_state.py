"""What state-only policies read is the target's state."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.core.features import ENVIRONMENT_STATE
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


@CHECKS.register("environment_state")
class EnvironmentState(Check):
    """Compares ``observation.environment_state``, where there is one, with the columns of the target."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield the first frame that differs."""
        if ENVIRONMENT_STATE not in columns:
            return
        truth = np.concatenate([columns["target.pose"], columns["target.velocity"]], axis=1)  # (T, 13)
        differs = (columns[ENVIRONMENT_STATE] != truth).any(axis=1)
        if differs.any():
            where = f"episode {row['episode_index']}, frame {differs.argmax()}"
            yield f"{where}: {ENVIRONMENT_STATE} is not target.pose and target.velocity"
