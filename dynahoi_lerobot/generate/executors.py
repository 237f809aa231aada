"""Shards as tasks of datatrove, where one pool of processes is not enough: on Slurm, on Ray, or on this machine.

The extra ``scale`` brings datatrove and Ray.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datatrove.executor import LocalPipelineExecutor, SlurmPipelineExecutor
from datatrove.executor.ray import RayPipelineExecutor
from datatrove.pipeline.base import PipelineStep
from multiprocess.process import parent_process

from dynahoi_lerobot.generate.pipeline import exit_with_parent, finished, open_workspace, workspace_path
from dynahoi_lerobot.generate.plan import GenerationError, GenerationPlan, Record
from dynahoi_lerobot.generate.shard import ShardMaker
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint

DEFAULT_TASKS = 1000
"""As many as Slurm takes in one array, if the plan has so many shards."""
PER_TASK = ("workers", "cpus_per_task", "mem_per_cpu_gb", "gpus_per_task")
"""What Slurm and Ray are told alike, by the name that ``ClusterResources`` and datatrove have for it."""


@dataclass(frozen=True)
class ClusterResources:
    """The resources that generation asks for.

    Attributes:
        tasks: number of tasks; each makes every tasks-th shard. None for one shard per task, up to ``DEFAULT_TASKS``.
        workers: how many tasks run at once; -1 for no limit.
        cpus_per_task: processor cores per task.
        mem_per_cpu_gb: memory per core [GB].
        gpus_per_task: GPUs per task.
        partition: Slurm partition.
        time: Slurm time limit per task, ``HH:MM:SS``.
    """

    tasks: int | None = None
    workers: int = -1
    cpus_per_task: int = 1
    mem_per_cpu_gb: int = 2
    gpus_per_task: int = 0
    partition: str = "cpu"
    time: str = "24:00:00"

    def __post_init__(self) -> None:
        """Refuse what neither datatrove nor Slurm explains.

        Raises:
            ValueError: if the time limit or the number of workers is none.
        """
        if not re.fullmatch(r"(\d+-)?\d+(:\d\d){0,2}", self.time):
            raise ValueError(f"the time limit is {self.time!r}; it must be like 24:00:00 or 2-00:00:00")
        if self.workers < 1 and self.workers != -1:
            raise ValueError(f"the number of workers is {self.workers}; it must be 1 or more, or -1 for no limit")


class MakeShards(PipelineStep):
    """Task ``rank`` of N makes the shards rank, rank + N, rank + 2 N, ...; those that exist are kept."""

    name = "shards"
    type = "dynahoi"

    def __init__(self, maker: ShardMaker) -> None:
        super().__init__()
        self.maker = maker

    def run(self, data: Any, rank: int = 0, world_size: int = 1) -> Iterator[Any]:
        """Make this task's shards.

        Raises:
            GenerationError: if this machine has other code than the plan.
        """
        yield from data or ()
        if parent_process() is not None:
            exit_with_parent(os.getppid())
        if (here := code_fingerprint()) != self.maker.plan.code:
            raise GenerationError(
                f"the plan was made by code {self.maker.plan.code}, this machine has {here}; update it"
            )
        for shard in range(rank, self.maker.plan.shards, world_size):
            self.maker.make(shard, lambda: self.stat_update("episodes"))


class MergeShards(PipelineStep):
    """One task merges all shards and removes them."""

    name = "merge"
    type = "dynahoi"

    def __init__(self, maker: ShardMaker, root: Path) -> None:
        super().__init__()
        self.maker, self.root = maker, root

    def run(self, data: Any, rank: int = 0, world_size: int = 1) -> Iterator[Any]:
        """Check the shards and merge them, unless it is done already.

        Raises:
            GenerationError: if a shard is missing, or was damaged after it was made.
        """
        yield from data or ()
        if finished(self.maker.plan, self.root) is None:
            damaged = self.maker.discard_damaged()
            if missing := self.maker.plan.shards - len(self.maker.finished()):
                found = f"{missing} of {self.maker.plan.shards} shards are missing, {len(damaged)} were damaged"
                raise GenerationError(f"{found}; see {self.maker.folder / 'logs'}, and run the same command again")
            self.maker.merge(self.root)
        for shard in range(self.maker.plan.shards):
            shutil.rmtree(self.maker.path(shard), ignore_errors=True)


def run(kind: str, plan: GenerationPlan, root: Path, record: Record, resources: ClusterResources) -> bool:
    """Make the dataset of a plan, or hand it to a queue. Shards that exist are checked and kept.

    Args:
        kind: ``local``, ``slurm`` or ``ray``.
        plan: what to make.
        root: the dataset's folder.
        record: plays the expert; a module's function.
        resources: what the tasks get.

    Returns:
        True if the dataset is complete now, False if a queue will complete it.

    Raises:
        FileExistsError: if ``root`` or the unfinished work beside it belongs to something else.
        GenerationError: if tasks failed.
    """
    root = root.absolute()
    if finished(plan, root) is not None:
        return True
    with open_workspace(plan, root) as workspace:
        maker = ShardMaker(plan, workspace, record)
        maker.discard_damaged()
        shards = MakeShards(maker), min(resources.tasks or DEFAULT_TASKS, plan.shards)
        merge = MergeShards(maker, root), 1
        if kind == "slurm":
            _executor(kind, *merge, resources, depends=_executor(kind, *shards, resources)).run()
            return False
        if kind == "ray":
            _connect_to_ray()
        for step, tasks in (shards, merge):
            _executor(kind, step, tasks, resources).run()
    return True


def describe(kind: str, plan: GenerationPlan, root: Path, record: Record, resources: ClusterResources) -> str:
    """Return what ``run`` would do, without doing it; for Slurm both batch scripts."""
    root, tasks = root.absolute(), min(resources.tasks or DEFAULT_TASKS, plan.shards)
    maker = ShardMaker(plan, workspace_path(root), record)
    if kind != "slurm":
        return f"{plan.shards} shards of up to {plan.shard_episodes} episodes in {tasks} tasks, merged into {root}"
    existed, scripts = maker.folder.exists(), []
    for step, count in ((MakeShards(maker), tasks), (MergeShards(maker, root), 1)):
        job = _executor(kind, step, count, resources)
        launch = f"srun -l -n 1 launch_pickled_pipeline {job.logging_dir.resolve_paths('executor.pik')}"
        scripts.append(job.get_launch_file_contents(job.get_sbatch_args(count), launch))
    if not existed:  # datatrove makes the log folders while it writes the scripts
        shutil.rmtree(maker.folder, ignore_errors=True)
    return "\n# submitted with --dependency=afterok:<the job above>\n".join(scripts)


def _executor(kind: str, step: Any, tasks: int, resources: ClusterResources, **options: Any) -> Any:
    """Return datatrove's executor of that kind, which runs ``step`` as so many tasks."""
    options |= {"tasks": tasks, "logging_dir": str(step.maker.folder / "logs" / step.name), "skip_completed": False}
    if kind == "local":
        workers = tasks if resources.workers == -1 else min(resources.workers, tasks)
        return LocalPipelineExecutor([step], workers=workers, start_method="spawn", **options)
    options |= {name: getattr(resources, name) for name in PER_TASK}
    if kind == "ray":
        return RayPipelineExecutor([step], **options)
    return SlurmPipelineExecutor(
        [step],
        time=resources.time,
        partition=resources.partition,
        job_name=f"dynahoi-{step.name}-{step.maker.folder.stem}",
        env_command=f"source {sys.prefix}/bin/activate",
        **options,
    )


def _connect_to_ray() -> None:
    """Use the cluster that ``ray.init`` finds, this machine if there is none."""
    # Below `uv run` Ray would start its workers by `uv run` in a copy of the working folder, where they die.
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    import ray

    if not ray.is_initialized():
        ray.init(include_dashboard=False)
