"""Tasks as processes of this machine, each run by datatrove."""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from dynahoi_lerobot.generate.executors.base import EXECUTORS, Executor
from dynahoi_lerobot.generate.parent_watch import exit_with_parent
from dynahoi_lerobot.generate.plan import GenerationError


@EXECUTORS.register("local")
class Local(Executor):
    """What a cluster does, on one machine.

    datatrove runs, logs and marks each task. The pool is ours: datatrove's and its manager outlive a killed parent.
    """

    def launch(self) -> bool:
        """Run both steps here."""
        from dynahoi_lerobot.generate.datatrove_steps import MakeShards, MergeShards

        self._run_tasks(MakeShards(self.maker), "shards", self.tasks)
        self.require_all_shards()
        self._run_tasks(MergeShards(self.maker, self.root), "merge", 1)
        return True

    def describe(self) -> str:
        """Say how the shards would be divided."""
        return (
            f"{self.plan.shards} shards of up to {self.plan.shard_episodes} episodes in {self.tasks} tasks, "
            f"{self._at_once(self.tasks)} at once on this machine, merged into {self.root}"
        )

    def _at_once(self, tasks: int) -> int:
        return tasks if self.resources.workers == -1 else min(self.resources.workers, tasks)

    def _run_tasks(self, step: Any, name: str, tasks: int) -> None:
        from datatrove.executor import LocalPipelineExecutor

        executor = LocalPipelineExecutor([step], tasks=tasks, logging_dir=str(self.logs / name))
        ranks = executor.get_incomplete_ranks(range(tasks))
        if self._at_once(tasks) == 1:
            for rank in ranks:
                executor._run_for_rank(rank)
            return
        context = multiprocessing.get_context("spawn")
        try:
            with ProcessPoolExecutor(self._at_once(tasks), context, exit_with_parent, (os.getpid(),)) as pool:
                list(pool.map(executor._run_for_rank, ranks, range(len(ranks))))
        except BrokenProcessPool:
            raise GenerationError("a task's process died; fewer workers need less memory") from None
