"""Shards: fixed lists of seeds, each written beside its place, renamed when complete, and checked before merging."""

import logging
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from dynahoi_lerobot.core.arguments import CommandError
from dynahoi_lerobot.core.files import new_folder
from dynahoi_lerobot.dataset.manifest import Manifest, file_problems
from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.dataset.quality_control import trajectory_problems
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.generate.plan import GenerationPlan, Record
from dynahoi_lerobot.sampling.splits import MAX_DRAWS, REDRAW_STRIDE

logger = logging.getLogger(__name__)

SHARD = "shard-"
"""Shards' folders have this name and a number of six digits or more."""


@dataclass(frozen=True)
class ShardMaker:
    """Makes, checks and merges the shards of a plan; it is pickled for worker processes.

    Attributes:
        plan: what to make.
        folder: where shards are made.
        record: plays the expert.
    """

    plan: GenerationPlan
    folder: Path
    record: Record

    def path(self, shard: int) -> Path:
        """Return where a finished shard lies."""
        return self.folder / f"{SHARD}{shard:06d}"

    def missing(self) -> list[int]:
        """Return the shards that are not there; those that are have been renamed into place when they were complete."""
        return [shard for shard in range(self.plan.shards) if not self.path(shard).is_dir()]

    def make(self, shard: int, tick: Callable[[], object] = lambda: None) -> None:
        """Make one shard, a dataset of its own, or do nothing if it is there; ``tick`` after each stored episode.

        Raises:
            CommandError: if a slot fails MAX_DRAWS times, or the recorder gives an episode of another seed.
            OSError: if the disk is full or refuses to be written.
        """
        target, plan = self.path(shard), self.plan
        if target.is_dir():
            return
        options = (plan.features, plan.encoding, plan.limits)
        with new_folder(target) as folder, DatasetWriter(folder, *options, subtasks=plan.subtasks) as writer:
            tally = self._fill(shard, writer, tick)
            writer.finish(plan.identity(), tally)

    def _fill(self, shard: int, writer: DatasetWriter, tick: Callable[[], object]) -> dict[str, int]:
        """Write an episode for every slot of a shard; failed slots are drawn again, with other seeds, after all others.

        Returns:
            How many seeds were tried, kept (of these failed), missed and rejected.
        """
        slots, tally = list(self.plan.slots(shard)), Counter(tried=0, kept=0, failed=0, missed=0, rejected=0)
        for draw in range(MAX_DRAWS):
            seeds = [slot + draw * REDRAW_STRIDE for slot in slots]
            missed, rejected = set(seeds), set[int]()
            for episode in self.record(self.plan.recipe, seeds):
                seed = episode.meta.seed
                if seed not in missed:
                    raise CommandError(f"the recorder gave an episode of seed {seed}, which was not asked for")
                missed.remove(seed)
                if trajectory_problems(episode):
                    rejected.add(seed)
                    continue
                writer.add(episode)
                tally["failed"] += not episode.success
                tick()
            kept = len(seeds) - len(missed) - len(rejected)
            tally.update(tried=len(seeds), kept=kept, missed=len(missed), rejected=len(rejected))
            again = missed | rejected
            slots = [slot for slot, seed in zip(slots, seeds, strict=True) if seed in again]
            if not slots:
                return dict(tally)
        raise CommandError(
            f"the expert failed {MAX_DRAWS} times on each of {len(slots)} slots, the first of seed {slots[0]}"
        )

    def problem(self, shard: int) -> str | None:
        """Say what keeps a shard that is there from being the plan's; every byte of it is read."""
        folder = self.path(shard)
        try:
            manifest = Manifest.read(folder)
        except (OSError, ValueError):
            return "its manifest cannot be read"
        if manifest.provenance != self.plan.identity():
            return "it belongs to another plan"
        if sorted(seed % REDRAW_STRIDE for seed in manifest.seeds) != list(self.plan.slots(shard)):
            return f"its seeds are not those of shard {shard}"
        return next(file_problems(folder, manifest), None)

    def discard_damaged(self) -> list[int]:
        """Remove shards that are not the plan's, so that they are made again; say which and why.

        Returns:
            The shards that were removed.
        """
        present = [shard for shard in range(self.plan.shards) if self.path(shard).is_dir()]
        problems = {shard: problem for shard in present if (problem := self.problem(shard))}
        for shard, problem in problems.items():
            logger.warning("%s is made again: %s", self.path(shard), problem)
            shutil.rmtree(self.path(shard))
        return list(problems)

    def merge(self, root: Path) -> Manifest:
        """Merge the shards, in the order of the plan, into the dataset ``root``."""
        sources, whole = [self.path(shard) for shard in range(self.plan.shards)], self.folder / "merged"
        shutil.rmtree(whole, ignore_errors=True)  # of a process that was killed before it renamed it
        manifest = merge(sources, whole, limits=self.plan.limits, provenance=self.plan.identity())
        whole.rename(root)
        return manifest
