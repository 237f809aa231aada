"""Tasks on a Ray cluster, whose machines share a file system."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dynahoi_lerobot.generate.executors.base import EXECUTORS, Executor
from dynahoi_lerobot.generate.plan import GenerationError

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
