"""The executor contract: how a plan's shards are spread over machines."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from dynahoi_lerobot.foundation.output import check_output
from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.generate.pipeline import finished
from dynahoi_lerobot.generate.plan import GenerationError, GenerationPlan, Record
from dynahoi_lerobot.generate.shard import ShardMaker
from dynahoi_lerobot.generate.workspace import open_workspace, workspace_path

DEFAULT_TASKS = 1000
"""Tasks unless told otherwise: as many as Slurm takes in one array, if the plan has so many shards."""
RANGES = {"tasks": (1, 100_000), "cpus_per_task": (1, 4096), "mem_per_cpu_gb": (1, 65_536), "gpus_per_task": (0, 64)}
"""Least and greatest values of ``ClusterResources``: what no cluster has is a mistake."""

EXECUTORS: Registry[type[Executor]] = Registry("executor", "dynahoi_lerobot.generate.executors")


@dataclass(frozen=True)
class ClusterResources:
    """The resources that generation asks a cluster for.

    Attributes:
        tasks: number of tasks; each makes every tasks-th shard. None for one shard per task, up to ``DEFAULT_TASKS``.
        workers: how many tasks run at once; -1 for no limit.
        cpus_per_task: processor cores per task.
        mem_per_cpu_gb: memory per core [GB].
        gpus_per_task: GPUs per task.
        partition: Slurm partition.
        time: Slurm time limit per task, ``HH:MM:SS``.
        activate: shell command that activates the Python environment on a Slurm node.
    """

    tasks: int | None = None
    workers: int = -1
    cpus_per_task: int = 1
    mem_per_cpu_gb: int = 2
    gpus_per_task: int = 0
    partition: str = "cpu"
    time: str = "24:00:00"
    activate: str = ""

    def __post_init__(self) -> None:
        """Refuse requests that no cluster can grant.

        Raises:
            ValueError: if a number is out of its range, or Slurm would not understand the time limit.
        """
        for name, (low, high) in RANGES.items():
            if (value := getattr(self, name)) is not None and not low <= value <= high:
                raise ValueError(f"{name} is {value}; it must be {low} to {high}")
        if not re.fullmatch(r"(\d+-)?\d+(:\d\d){0,2}", self.time):
            raise ValueError(f"the time limit is {self.time!r}; it must be like 24:00:00 or 2-00:00:00")
        if self.workers < 1 and self.workers != -1:
            raise ValueError(f"the number of workers is {self.workers}; it must be 1 or more, or -1 for no limit")


class Executor(ABC):
    """Runs the two steps of a plan. datatrove marks finished tasks below the workspace and skips them."""

    def __init__(self, plan: GenerationPlan, root: Path, record: Record, resources: ClusterResources) -> None:
        """Prepare to make ``plan`` at ``root``; nothing is written yet.

        Raises:
            ValueError: if no folder can be made at ``root``.
        """
        check_output(root)
        self.plan, self.root, self.resources = plan, root.absolute(), resources
        self.maker = ShardMaker(plan, workspace_path(self.root), record)
        self.tasks = min(resources.tasks or DEFAULT_TASKS, plan.shards)
        self.logs = self.maker.folder / "logs"

    def run(self) -> bool:
        """Make the dataset, or hand it to a queue.

        Returns:
            True if the dataset is complete now, False if a queue will complete it.

        Raises:
            FileExistsError: if ``root`` or the unfinished work beside it belongs to something else.
            GenerationError: if tasks failed, or another process is making this dataset.
        """
        if finished(self.plan, self.root) is not None:
            return True
        with open_workspace(self.plan, self.root):
            self.maker.discard_damaged()
            self._forget_lost_work()
            return self.launch()

    @abstractmethod
    def launch(self) -> bool:
        """Run or submit both steps; see ``run``."""

    @abstractmethod
    def describe(self) -> str:
        """Return what ``run`` would do, without doing it."""

    def require_all_shards(self) -> None:
        """Make sure that the first step left nothing out.

        Raises:
            GenerationError: if a shard is missing.
        """
        if missing := self.plan.shards - len(self.maker.finished()):
            raise GenerationError(f"{missing} of {self.plan.shards} shards failed; see {self.logs / 'shards/logs'}")

    def _forget_lost_work(self) -> None:
        """Remove the completion marks of tasks whose shards are gone."""
        finished = self.maker.finished()
        for mark in self.logs.glob("shards/completions/*"):
            if not finished.issuperset(range(int(mark.name), self.plan.shards, self.tasks)):
                mark.unlink()
        (self.logs / "merge/completions/00000").unlink(missing_ok=True)
