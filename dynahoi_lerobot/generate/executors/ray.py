"""Tasks on a Ray cluster, whose machines share a file system."""

from __future__ import annotations

from typing import Any

from dynahoi_lerobot.generate.executors.base import EXECUTORS, Executor


@EXECUTORS.register("ray")
class Ray(Executor):
    """``RayPipelineExecutor`` on the cluster that ``ray.init`` finds; on this machine if there is none."""

    def launch(self) -> bool:
        """Run both steps and wait for them."""
        import ray

        from dynahoi_lerobot.generate.datatrove_steps import MakeShards, MergeShards

        if not ray.is_initialized():
            ray.init(include_dashboard=False)
        self._executor(MakeShards(self.maker), "shards", self.tasks).run()
        self.require_all_shards()
        self._executor(MergeShards(self.maker, self.root), "merge", 1).run()
        return True

    def describe(self) -> str:
        """Say what the cluster would be asked for."""
        resources = self.resources
        memory_gb = resources.mem_per_cpu_gb * resources.cpus_per_task
        return (
            f"{self.plan.shards} shards of up to {self.plan.shard_episodes} episodes in {self.tasks} Ray tasks of "
            f"{resources.cpus_per_task} CPUs, {resources.gpus_per_task} GPUs and {memory_gb} GB, "
            f"merged into {self.root}"
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
