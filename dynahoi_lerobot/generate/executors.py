"""Where shards are made when one pool of processes is not enough: Slurm, Ray, or tasks on this machine.

datatrove schedules them; the extra ``scale`` brings it.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import shutil
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.core.registry import Registry
from dynahoi_lerobot.generate.parent_watch import exit_with_parent
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


@EXECUTORS.register("slurm")
class Slurm(Executor):
    """``SlurmPipelineExecutor``: one array job for the shards, and one that merges when all of them succeeded."""

    def launch(self) -> bool:
        """Submit both jobs; they run when the queue lets them."""
        self._jobs()[1].run()
        return False

    def describe(self) -> str:
        """Return both batch scripts."""
        existed = self.maker.folder.exists()
        shards, merge = self._jobs()
        scripts = [
            self._script(shards, self.tasks),
            "# submitted with --dependency=afterok:<the job above>",
            self._script(merge, 1),
        ]
        if not existed:
            # datatrove makes the log folders while it writes the scripts.
            shutil.rmtree(self.maker.folder, ignore_errors=True)
        return "\n".join(scripts)

    def _script(self, job: Any, tasks: int) -> str:
        path = job.logging_dir.resolve_paths("executor.pik")
        return job.get_launch_file_contents(job.get_sbatch_args(tasks), f"srun -l -n 1 launch_pickled_pipeline {path}")

    def _jobs(self) -> tuple[Any, Any]:
        from dynahoi_lerobot.generate.datatrove_steps import MakeShards, MergeShards

        shards = self._job(MakeShards(self.maker), "shards", self.tasks)
        return shards, self._job(MergeShards(self.maker, self.root), "merge", 1, depends=shards)

    def _job(self, step: Any, name: str, tasks: int, **options: Any) -> Any:
        from datatrove.executor import SlurmPipelineExecutor

        resources = self.resources
        return SlurmPipelineExecutor(
            [step],
            tasks=tasks,
            time=resources.time,
            partition=resources.partition,
            cpus_per_task=resources.cpus_per_task,
            mem_per_cpu_gb=resources.mem_per_cpu_gb,
            gpus_per_task=resources.gpus_per_task,
            workers=resources.workers,
            job_name=f"dynahoi-{name}-{self.root.name}",
            env_command=resources.activate or f"source {sys.prefix}/bin/activate",
            logging_dir=str(self.logs / name),
            **options,
        )


START_S = 60.0
"""How long the first worker process may take to start [s]. Ray itself starts processes that die again, for ever."""
UV_HOOK = "RAY_ENABLE_UV_RUN_RUNTIME_ENV"
"""Below ``uv run`` Ray starts its workers by ``uv run`` in a copy of the working folder, in an environment that is
empty or made anew, so they die or have other code than the plan. ``0``, read when Ray is imported, leaves them this
environment.
"""


@EXECUTORS.register("ray")
class Ray(Executor):
    """``RayPipelineExecutor`` on the cluster that ``ray.init`` finds; on this machine if there is none."""

    def launch(self) -> bool:
        """Run both steps and wait for them.

        Raises:
            GenerationError: if no machine is large enough for a task, or Ray starts no worker process in ``START_S``.
        """
        from dynahoi_lerobot.generate.datatrove_steps import MakeShards, MergeShards

        with _connected() as ray:
            self._require_room(ray)
            _require_workers(ray)
            self._executor(MakeShards(self.maker), "shards", self.tasks).run()
            self.require_all_shards()
            self._executor(MergeShards(self.maker, self.root), "merge", 1).run()
        return True

    def describe(self) -> str:
        """Say what the cluster would be asked for."""
        resources = self.resources
        return (
            f"{self.plan.shards} shards of up to {self.plan.shard_episodes} episodes in {self.tasks} Ray tasks of "
            f"{resources.cpus_per_task} CPUs, {resources.gpus_per_task} GPUs and {self._memory_gb} GB, "
            f"merged into {self.root}"
        )

    @property
    def _memory_gb(self) -> int:
        return self.resources.mem_per_cpu_gb * self.resources.cpus_per_task

    def _require_room(self, ray: Any) -> None:
        """Refuse tasks for which Ray would wait for ever, because no machine of the cluster is large enough."""
        needed = {
            "CPU": self.resources.cpus_per_task,
            "GPU": self.resources.gpus_per_task,
            "memory": self._memory_gb << 30,
        }
        machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        if not any(all(machine.get(name, 0) >= amount for name, amount in needed.items()) for machine in machines):
            found = "; ".join(
                f"{machine.get('CPU', 0):.0f} CPUs, {machine.get('GPU', 0):.0f} GPUs, "
                f"{machine.get('memory', 0) / 2**30:.1f} GB"
                for machine in machines
            )
            raise GenerationError(
                f"a task needs {needed['CPU']} CPUs, {needed['GPU']} GPUs and {self._memory_gb} GB, and no machine of "
                f"the Ray cluster has them: {found}"
            )

    def _executor(self, step: Any, name: str, tasks: int) -> Any:
        from datatrove.executor.ray import RayPipelineExecutor

        return RayPipelineExecutor(
            [step],
            tasks=tasks,
            workers=self.resources.workers,
            logging_dir=str(self.logs / name),
            cpus_per_task=self.resources.cpus_per_task,
            gpus_per_task=self.resources.gpus_per_task,
            mem_per_cpu_gb=self.resources.mem_per_cpu_gb,
        )


@contextmanager
def _connected() -> Iterator[Any]:
    """Give Ray, connected to a cluster; disconnect at the end, unless the caller had connected."""
    os.environ.setdefault(UV_HOOK, "0")
    import ray

    if ray.is_initialized():
        yield ray
        return
    ray.init(include_dashboard=False)
    try:
        yield ray
    finally:
        ray.shutdown()


def _require_workers(ray: Any) -> None:
    """Run a task that does nothing and needs nothing but a worker process.

    Raises:
        GenerationError: if it does not end in ``START_S``.
    """
    task = ray.remote(num_cpus=0)(_do_nothing).remote()
    try:
        ray.get(task, timeout=START_S)
    except ray.exceptions.RayError as error:
        session = ray.get_runtime_context().get_session_name()
        raise GenerationError(
            f"Ray ran no task within {START_S:.0f} s ({type(error).__name__}); the logs of its {session} say why "
            "its worker processes do not start"
        ) from None


def _do_nothing() -> None:
    """Be a task of Ray."""
