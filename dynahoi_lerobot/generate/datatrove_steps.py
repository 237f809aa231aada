"""The two steps of generation as datatrove runs them: make shards, one or more per task, then merge them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from datatrove.pipeline.base import PipelineStep

from dynahoi_lerobot.generate.pipeline import finished
from dynahoi_lerobot.generate.plan import GenerationError
from dynahoi_lerobot.generate.shard import ShardMaker
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint


class MakeShards(PipelineStep):
    """Task ``rank`` of N makes the shards rank, rank + N, rank + 2 N, ..."""

    name = "shards"
    type = "dynahoi"

    def __init__(self, maker: ShardMaker) -> None:
        """Make shards with ``maker``."""
        super().__init__()
        self.maker = maker

    def run(self, data: Any, rank: int = 0, world_size: int = 1) -> Iterator[Any]:
        """Make this task's shards; those that exist are kept.

        Raises:
            GenerationError: if this machine has other code than the plan.
        """
        yield from data or ()
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
        """Merge what ``maker`` made into ``root``."""
        super().__init__()
        self.maker, self.root = maker, root

    def run(self, data: Any, rank: int = 0, world_size: int = 1) -> Iterator[Any]:
        """Check the shards and merge them, unless it is done already.

        Raises:
            GenerationError: if a shard was damaged after it was made.
        """
        yield from data or ()
        if finished(self.maker.plan, self.root) is None:
            if damaged := self.maker.discard_damaged():
                raise GenerationError(f"{len(damaged)} shards were damaged; run the same command again to make them")
            self.maker.merge(self.root)
        for shard in range(self.maker.plan.shards):
            shutil.rmtree(self.maker.path(shard), ignore_errors=True)
