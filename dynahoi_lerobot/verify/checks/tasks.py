"""Every frame's task is its episode's instruction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


@CHECKS.register("tasks")
class Tasks(Check):
    """Compares ``task_index``, the task table and the episode table."""

    of_the_format = True

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield instructions that occur twice or never."""
        tasks = dataset.tasks
        if len(set(tasks)) != len(tasks):
            yield "the task table holds an instruction twice"
        used = {task for row in dataset.rows for task in row["tasks"]}
        yield from (f"no episode has the task {task!r}" for task in tasks if task not in used)

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield an episode whose frames have another instruction than its row."""
        number, tasks = row["episode_index"], dataset.tasks
        for index in np.unique(columns["task_index"]):
            text = tasks[index] if 0 <= index < len(tasks) else None
            if row["tasks"] != [text] or row.get("task", text) != text:
                told = row.get("task", row["tasks"])
                yield f"episode {number} has frames of task {index} ({text!r}); its instruction is {told!r}"
