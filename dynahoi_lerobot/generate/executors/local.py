"""Tasks as processes of this machine, run by datatrove."""

from __future__ import annotations

from dynahoi_lerobot.generate.executors.base import EXECUTORS, Executor


@EXECUTORS.register("local")
class Local(Executor):
    """``LocalPipelineExecutor``: what a cluster does, on one machine."""

    def launch(self) -> bool:
        """Run both steps here."""
        from datatrove.executor import LocalPipelineExecutor

        from dynahoi_lerobot.generate.datatrove_steps import MakeShards, MergeShards

        shards = LocalPipelineExecutor(
            [MakeShards(self.maker)],
            tasks=self.tasks,
            workers=self.resources.workers,
            logging_dir=str(self.logs / "shards"),
            start_method="spawn",
        )
        shards.run()
        self.require_all_shards()
        merge = LocalPipelineExecutor(
            [MergeShards(self.maker, self.root)], workers=1, logging_dir=str(self.logs / "merge")
        )
        merge.run()
        return True

    def describe(self) -> str:
        """Say how the shards would be divided."""
        at_once = self.tasks if self.resources.workers == -1 else self.resources.workers
        return (
            f"{self.plan.shards} shards of up to {self.plan.shard_episodes} episodes in {self.tasks} tasks, {at_once} "
            f"at once on this machine, merged into {self.root}"
        )
