"""Every stored trajectory passes the rules by which generation rejects recordings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.control_class import control_class_of
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.quality_control import TrajectoryLimits, trajectory_problems
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


@CHECKS.register("plausibility")
class Plausibility(Check):
    """Applies ``dataset/quality_control.py`` to every stored episode."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield the rules that the episode breaks."""
        limits = limits_of(row["capture"], row["control_class"])
        problems = trajectory_problems(columns, np.asarray(row["stats/home_position"], float), limits)
        yield from (f"episode {row['episode_index']}: {problem}" for problem in problems)


def limits_of(capture: str, control_class: str) -> TrajectoryLimits:
    """Return the limits of a hand that was played under a capture rule and a control class.

    Raises:
        ValueError: if one of the names is unknown.
    """
    return TrajectoryLimits.of_class(control_class_of(control_class), CAPTURES[capture].gantry_speed_m_s)
