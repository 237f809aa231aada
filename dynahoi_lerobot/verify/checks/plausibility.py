"""Every stored trajectory passes the rules by which generation rejects recordings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.quality_control import limits_of, trajectory_problems
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


@CHECKS.register("plausibility")
class Plausibility(Check):
    """Applies ``dataset/quality_control.py`` to every stored episode."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield the rules that the episode breaks."""
        limits = limits_of(row["capture"], row["control_class"])
        problems = trajectory_problems(columns, np.asarray(row["stats/home_position"], float), limits)
        yield from (f"episode {row['episode_index']}: {problem}" for problem in problems)
