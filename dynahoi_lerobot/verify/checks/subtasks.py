"""Subtasks say what phase and localisation say."""

from __future__ import annotations

from collections.abc import Iterator

from dynahoi_lerobot.core.rules import is_acting
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.language import LANGUAGE, subtask_rows
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


@CHECKS.register("subtasks")
class Subtasks(Check):
    """Derives the subtasks, where there are any, again."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield the first frame with other subtasks."""
        if LANGUAGE not in dataset.features:
            return
        wanted = subtask_rows(is_acting(columns["observation.phase"]), columns["localized"][:, 0].astype(bool))
        for frame, found in enumerate(dataset.frames(row)[LANGUAGE].to_pylist()):
            if found != wanted:
                where = f"episode {row['episode_index']}, frame {frame}"
                yield f"{where}: {LANGUAGE} is {found}; phase and localisation give {wanted}"
                return
