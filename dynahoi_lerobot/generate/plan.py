"""What is to be made: a plan of which seeds go into which shard, and its shards. A dataset is a
function of the plan.

Shards are fixed lists of seeds, each written beside its place, renamed when complete, and checked
before merging.
"""

import logging
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.arguments import CommandError
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import privileged_features
from dynahoi_lerobot.core.files import new_folder
from dynahoi_lerobot.core.nested import as_json
from dynahoi_lerobot.core.reading import ReadError
from dynahoi_lerobot.dataset.manifest import Manifest, file_problems
from dynahoi_lerobot.dataset.merge import merge_in_turn
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.quality_control import broken_rules
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.sampling.splits import MAX_DRAWS, REDRAW_STRIDE

logger = logging.getLogger(__name__)

Record = Callable[[Any, Sequence[int]], Iterator[Episode]]
"""Plays a `Recording`: yields the episodes among the seeds that are to be stored, in their order,
at most one per seed, which is a deterministic function of (recording, seed)."""
Progress = Callable[[int], object]
"""Called now and then with the number of episodes that are done."""

LARGEST_SHARD = 256
"""Episodes: large enough that starting a shard costs nothing, small enough to redo."""
MAX_SHARD = 65_536
"""Episodes: the seeds of one shard are held in memory."""
SHARD = "shard-"
"""Shards' folders have this name and a number of six digits or more."""


def shard_size(episodes: int) -> int:
    """Return how many episodes a shard holds where nothing is said: small datasets, too, keep eight
    workers busy.
    """
    return max(1, min(LARGEST_SHARD, -(-episodes // 8)))


@dataclass(frozen=True)
class GenerationPlan:
    """A dataset to be made.

    Episode slot i of the dataset has the seed ``seed + i``, or a redraw of it. So a dataset that
    starts where another ends shares no seed with it, and the seeds do not depend on the shards.

    Attributes:
        recording: what to play.
        episodes: how many to store.
        seed: the first episode's seed.
        encoding: how to store them.
        limits: file size limits.
        shard_episodes: episodes per shard, the unit of work; an interrupted shard is made again.
        code: fingerprint of the code that plans; other machines must have the same.
        runtime: what else a policy's actions depend on, see ``generate.actor.runtime``; empty
            without one.
        subtasks: whether to store subtasks as LeRobot's column for language.
    """

    recording: Recording
    episodes: int
    seed: int = 0
    encoding: Encoding = field(default_factory=Encoding)
    limits: FileLimits = field(default_factory=FileLimits)
    shard_episodes: int = LARGEST_SHARD
    code: str = field(default_factory=code_fingerprint)
    runtime: str = ""
    subtasks: bool = False

    def __post_init__(self) -> None:
        """Refuse plans that cannot be carried out; ValueError if a number is out of its range."""
        if not 1 <= self.episodes <= REDRAW_STRIDE:
            raise ValueError(
                f"the number of episodes is {self.episodes}; it must be 1 to {REDRAW_STRIDE}"
            )
        if not 1 <= self.shard_episodes <= MAX_SHARD:
            raise ValueError(
                f"the number of episodes per shard is {self.shard_episodes}; it must be 1 to "
                f"{MAX_SHARD}"
            )
        if not 0 <= self.seed <= REDRAW_STRIDE - self.episodes:
            raise ValueError(
                f"the seed is {self.seed}; it must be 0 to {REDRAW_STRIDE - self.episodes} for "
                f"{self.episodes} episodes"
            )
        self.encoding.check_size(self.recording.recipe.rules.image_size)

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.episodes // self.shard_episodes)

    def slots(self, shard: int) -> range:
        """Return the first draws of a shard's seeds."""
        first = shard * self.shard_episodes
        last = min(first + self.shard_episodes, self.episodes)
        return range(self.seed + first, self.seed + last)

    def identity(self) -> dict[str, Any]:
        """Return everything that decides the dataset's bytes, as JSON values."""
        return as_json(self) | {"recording": self.recording.stored()}


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
        """Return the shards that do not exist yet; a shard is renamed into place when it is
        complete.
        """
        return [shard for shard in range(self.plan.shards) if not self.path(shard).is_dir()]

    def make(self, shard: int, tick: Callable[[], object] = lambda: None) -> None:
        """Make one shard, a dataset of its own, or do nothing if it is there; ``tick`` after each
        stored episode.

        Raises:
            CommandError: if a slot fails MAX_DRAWS times, or the recorder gives an episode of
                another seed.
            OSError: if the disk is full or refuses to be written.
        """
        target = self.path(shard)
        plan = self.plan
        if target.is_dir():
            return
        columns = (*plan.recording.recipe.rules.features, *privileged_features())
        options = (columns, plan.encoding, plan.limits)
        try:
            with (
                new_folder(target) as folder,
                DatasetWriter(folder, *options, subtasks=plan.subtasks) as writer,
            ):
                tally = self._fill(shard, writer, tick)
                writer.finish(plan.identity(), tally)
        except FileExistsError:
            if not target.is_dir():  # made by another process, with the same content
                raise

    def _fill(
        self, shard: int, writer: DatasetWriter, tick: Callable[[], object]
    ) -> dict[str, int]:
        """Write an episode for every slot of a shard; failed slots are drawn again, with other
        seeds, after all others.

        Returns:
            How many seeds were tried, kept (of these failed), missed and rejected.
        """
        slots = list(self.plan.slots(shard))
        tally = Counter(tried=0, kept=0, failed=0, missed=0, rejected=0)
        for draw in range(MAX_DRAWS):
            seeds = [slot + draw * REDRAW_STRIDE for slot in slots]
            missed = set(seeds)
            rejected = set[int]()
            for episode in self.record(self.plan.recording, seeds):
                seed = episode.meta.seed
                if seed not in missed:
                    raise CommandError(
                        f"the recorder gave an episode of seed {seed}, which was not asked for"
                    )
                missed.remove(seed)
                if broken_rules(episode):
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
            f"the expert failed {MAX_DRAWS} times on each of {len(slots)} slots, the first of "
            f"seed {slots[0]}"
        )

    def problem(self, shard: int) -> str | None:
        """Say what keeps a shard that is there from being the plan's; every byte of it is read."""
        folder = self.path(shard)
        try:
            manifest = Manifest.read(folder)
        except ReadError:
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
            self.path(shard).unlink() if self.path(shard).is_symlink() else shutil.rmtree(
                self.path(shard)
            )
        return list(problems)

    def merge(self, root: Path, shards: Iterable[int] | None = None) -> Manifest:
        """Merge the shards, in the order of the plan, into the dataset ``root``.

        ``shards`` yields each of them when it is there; by default all are.
        """
        made = range(self.plan.shards) if shards is None else shards
        whole = self.folder / "merged"
        shutil.rmtree(
            whole, ignore_errors=True
        )  # of a process that was killed before it renamed it
        manifest = merge_in_turn(
            (self.path(shard) for shard in made),
            whole,
            limits=self.plan.limits,
            provenance=self.plan.identity(),
        )
        whole.rename(root)
        return manifest
