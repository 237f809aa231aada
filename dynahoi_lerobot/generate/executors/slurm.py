"""Tasks as a Slurm job array, whose nodes share a file system."""

from __future__ import annotations

import shutil
import sys
from typing import Any

from dynahoi_lerobot.generate.executors.base import EXECUTORS, Executor


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
