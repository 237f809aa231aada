"""Shards as tasks of datatrove, where one pool of processes is not enough: on Slurm, on Ray, or on
this machine.

The extra ``scale`` brings datatrove and Ray.
"""

import os
import shutil
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from datatrove.executor import LocalPipelineExecutor, SlurmPipelineExecutor
from datatrove.executor.ray import RayPipelineExecutor
from multiprocess.process import parent_process

from dynahoi_lerobot.core.arguments import CommandError
from dynahoi_lerobot.core.working_folder import workspace_path
from dynahoi_lerobot.generate.pipeline import exit_with_parent, finished, open_workspace
from dynahoi_lerobot.generate.plan import GenerationPlan, Record, ShardMaker
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint

DEFAULT_TASKS = 1000
"""As many as Slurm takes in one array, if the plan has so many shards."""
PER_TASK = ("workers", "cpus_per_task", "mem_per_cpu_gb", "gpus_per_task")
"""What Slurm and Ray are told alike, by the name that ``ClusterResources`` and datatrove have for
it."""


@dataclass(frozen=True)
class ClusterResources:
    """The resources that generation asks for.

    Attributes:
        tasks: number of tasks; each makes every tasks-th shard. None for one shard per task, up to
            ``DEFAULT_TASKS``.
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


def make_shards(maker: ShardMaker, data: Any, rank: int, world_size: int) -> None:
    """Task ``rank`` of N makes the shards rank, rank + N, rank + 2 N, ...; existing shards
    are kept.

    Raises:
        CommandError: if this machine has other code than the plan.
    """
    if parent_process() is not None:
        exit_with_parent(os.getppid())
    here = code_fingerprint()
    if here != maker.plan.code:
        raise CommandError(
            f"the plan was made by code {maker.plan.code}, this machine has {here}; update it"
        )
    for shard in range(rank, maker.plan.shards, world_size):
        maker.make(shard)


def merge_shards(
    maker: ShardMaker, root: Path, data: Any = None, rank: int = 0, world_size: int = 1
) -> None:
    """One task checks all shards, merges them into ``root`` unless that is done already, and
    removes them.

    Raises:
        CommandError: if a shard is missing, or was damaged after it was made.
    """
    if finished(maker.plan, root) is None:
        damaged = maker.discard_damaged()
        missing = maker.missing()
        if missing:
            found = (
                f"{len(missing)} of {maker.plan.shards} shards are missing, {len(damaged)} "
                f"were damaged"
            )
            raise CommandError(
                f"{found}; see {maker.folder / 'logs'}, and run the same command again"
            )
        maker.merge(root)
    for shard in range(maker.plan.shards):
        shutil.rmtree(maker.path(shard), ignore_errors=True)


def run(
    kind: str, plan: GenerationPlan, root: Path, record: Record, resources: ClusterResources
) -> bool:
    """Make the dataset of a plan, or hand it to a queue. Shards that exist are checked and kept.

    Args:
        kind: ``local``, ``slurm`` or ``ray``.
        plan, root, record: see ``pipeline.generate``, which also lists the errors.
        resources: of each task.

    Returns:
        True if the dataset is complete now, False if a queue will complete it.
    """
    root = root.absolute()
    if finished(plan, root) is not None:
        return True
    if kind == "slurm" and shutil.which("sbatch") is None:
        raise CommandError(
            "--executor slurm needs Slurm's command sbatch, which this machine does not have"
        )
    with open_workspace(plan, root) as workspace:
        maker = ShardMaker(plan, workspace, record)
        maker.discard_damaged()
        if kind == "ray":
            _connect_to_ray()
        shards, merge = _executors(kind, maker, root, resources)
        if kind == "slurm":
            merge.depends = shards
            merge.run()
            return False
        shards.run()
        merge.run()
    return True


def describe(
    kind: str, plan: GenerationPlan, root: Path, record: Record, resources: ClusterResources
) -> str:
    """Return what ``run`` would do, without doing it; for Slurm both batch scripts."""
    root = root.absolute()
    tasks = min(resources.tasks or DEFAULT_TASKS, plan.shards)
    maker = ShardMaker(plan, workspace_path(root), record)
    if kind != "slurm":
        return (
            f"{plan.shards} shards of up to {plan.shard_episodes} episodes in {tasks} tasks, "
            f"merged into {root}"
        )
    existed = maker.folder.exists()
    scripts = []
    for job in _executors(kind, maker, root, resources):
        launch = (
            f"srun -l -n 1 launch_pickled_pipeline {job.logging_dir.resolve_paths('executor.pik')}"
        )
        scripts.append(job.get_launch_file_contents(job.get_sbatch_args(job.tasks), launch))
    if not existed:  # datatrove makes the log folders while it writes the scripts
        shutil.rmtree(maker.folder, ignore_errors=True)
    return "\n# submitted with --dependency=afterok:<the job above>\n".join(scripts)


def _executors(kind: str, maker: ShardMaker, root: Path, resources: ClusterResources) -> list[Any]:
    """Return datatrove's executors of that kind, of the tasks that make shards and of the one that
    merges them.
    """
    tasks = min(resources.tasks or DEFAULT_TASKS, maker.plan.shards)
    return [
        _executor(
            kind, maker.folder, resources, partial(make_shards, maker), name="shards", tasks=tasks
        ),
        _executor(
            kind, maker.folder, resources, partial(merge_shards, maker, root), name="merge", tasks=1
        ),
    ]


def _executor(
    kind: str, folder: Path, resources: ClusterResources, function: Any, *, name: str, tasks: int
) -> Any:
    options = {"tasks": tasks, "logging_dir": str(folder / "logs" / name), "skip_completed": False}
    if kind == "local":
        workers = tasks if resources.workers == -1 else min(resources.workers, tasks)
        return LocalPipelineExecutor([function], workers=workers, start_method="spawn", **options)
    options |= {limit: getattr(resources, limit) for limit in PER_TASK}
    if kind == "ray":
        return RayPipelineExecutor([function], **options)
    return SlurmPipelineExecutor(
        [function],
        time=resources.time,
        partition=resources.partition,
        job_name=f"dynahoi-{name}-{folder.stem}",
        env_command=f"source {sys.prefix}/bin/activate",
        **options,
    )


def _connect_to_ray() -> None:
    """Use the cluster that ``ray.init`` finds, this machine if there is none."""
    # Below `uv run` Ray would start its workers by `uv run` in a copy of the working folder, where
    # they die.
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    import ray

    if not ray.is_initialized():
        ray.init(include_dashboard=False)
