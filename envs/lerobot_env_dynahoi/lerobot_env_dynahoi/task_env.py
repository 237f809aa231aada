"""One task of the benchmark for LeRobot's evaluation loop, and the results it leaves behind.

LeRobot's loop keeps rewards and successes only, so the envs themselves write the benchmark's result
folder: the same files that ``dynahoi evaluate`` writes.
"""

from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.env.vector_env import DynahoiVectorEnv
from dynahoi_lerobot.evaluate.results import METRICS_FILE, Results, RunInfo
from dynahoi_lerobot.evaluate.table import results_table


class ResultsLog:
    """Collects the finished episodes of all tasks of one evaluation and writes them as one result
    folder.
    """

    def __init__(self, folder: Path, info: RunInfo) -> None:
        """Write episodes of the run ``info`` into ``folder`` whenever a task ends.

        Raises:
            ValueError: if the folder holds results.
        """
        refuse_results(folder)
        self._results = Results(folder, info)
        self._unwritten = False

    def __call__(self, episode: Episode) -> None:
        """Keep an episode, once: LeRobot fills its last batch with episodes it has played
        before.
        """
        if episode.meta.seed not in self._results.seeds:
            self._results = self._results.plus([episode])
            self._unwritten = True

    def write(self) -> None:
        """Write the folder if there is anything new, and print the table."""
        if not self._unwritten:
            return
        self._results.write()
        self._unwritten = False
        print(
            f"{results_table([self._results])}\nmetrics so far: {self._results.folder}", flush=True
        )


def refuse_results(folder: Path) -> None:
    """Raise a ValueError if a folder holds results, which an evaluation would replace."""
    if (folder / METRICS_FILE).exists():
        raise ValueError(
            f"{folder} holds results; remove it, or name another folder by env.results_dir"
        )


class TaskEnv(DynahoiVectorEnv):
    """A vector env of one kind of motion whose ``on_episode`` is a log."""

    _on_episode: ResultsLog

    def close_extras(self, **kwargs: Any) -> None:
        """Write the episodes played so far."""
        self._on_episode.write()
