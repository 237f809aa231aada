"""One shard: a fixed list of slots, written beside its place and renamed when whole."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from av.error import FFmpegError

from dynahoi_lerobot.dataset.episode_arrays import content_arrays
from dynahoi_lerobot.dataset.files import temporary_sibling
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.generate.plan import MAX_DRAWS, REDRAW_STRIDE, GenerationError, Plan, Record
from dynahoi_lerobot.verify.plausibility import implausibilities

Tick = Callable[[], object]
"""Called after each stored episode."""


@dataclass(frozen=True)
class ShardMaker:
    """Makes the shards of a plan; travels to other processes.

    Attributes:
        plan: what to make.
        folder: where shards are made.
        record: plays the expert.
    """

    plan: Plan
    folder: Path
    record: Record

    def path(self, shard: int) -> Path:
        """Return where a finished shard lies."""
        return self.folder / f"shard-{shard:06d}"

    def missing(self) -> list[int]:
        """Return the shards that are still to be made."""
        return [shard for shard in range(self.plan.shards) if not is_whole(self.path(shard))]

    def done_episodes(self) -> int:
        """Return the number of episodes in finished shards."""
        missing = sum(len(self.plan.slots(shard)) for shard in self.missing())
        return self.plan.episodes - missing

    def make(self, shard: int, tick: Tick = lambda: None) -> Path:
        """Make one shard, or do nothing if it is already whole.

        Returns:
            The shard's folder, a dataset of its own.

        Raises:
            GenerationError: if a slot fails MAX_DRAWS times.
            OSError: if the disk is full or refuses to be written.
        """
        target = self.path(shard)
        if is_whole(target):
            return target
        shutil.rmtree(target, ignore_errors=True)
        with temporary_sibling(target) as temporary:
            plan = self.plan
            writer = DatasetWriter(temporary, plan.features, plan.encoding, plan.layout)
            try:
                tally = _Filling(self, writer, tick).fill(shard)
                writer.finish(yields=tally)
            except FFmpegError as error:
                # FFmpeg's own errors cannot travel between processes.
                raise OSError(error.errno, error.strerror, str(target)) from None
            finally:
                writer.abandon()
        return target


def is_whole(folder: Path) -> bool:
    """Tell whether a shard's files are all there; they are renamed into place together."""
    try:
        manifest = Manifest.read(folder)
    except (OSError, ValueError, TypeError):
        return False
    return all((folder / name).is_file() for name in manifest.files)


class _Filling:
    """Writes one episode per slot; failed slots are drawn again after all others."""

    def __init__(self, maker: ShardMaker, writer: DatasetWriter, tick: Tick) -> None:
        self._maker, self._writer, self._tick = maker, writer, tick
        self._tally = Counter(tried=0, kept=0, missed=0, rejected=0)

    def fill(self, shard: int) -> dict[str, int]:
        """Fill every slot of the shard; return how many seeds were tried, kept, missed and rejected."""
        open_slots = list(self._maker.plan.slots(shard))
        for draw in range(MAX_DRAWS):
            seeds = [slot + draw * REDRAW_STRIDE for slot in open_slots]
            kept = self._play(seeds)
            open_slots = [slot for slot, seed in zip(open_slots, seeds, strict=True) if seed not in kept]
            if not open_slots:
                return dict(self._tally)
        raise GenerationError(
            f"the expert failed {MAX_DRAWS} times on each of {len(open_slots)} slots, the first of seed {open_slots[0]}"
        )

    def _play(self, seeds: list[int]) -> set[int]:
        expected, seen, kept = set(seeds), set(), set()
        for episode in self._maker.record(self._maker.plan.recipe, seeds):
            seed = episode.meta.seed
            if seed not in expected - seen:
                raise GenerationError(f"the recorder gave an episode of seed {seed}, which was not asked for")
            seen.add(seed)
            if not implausibilities(content_arrays(episode)):
                self._writer.add(episode)
                kept.add(seed)
                self._tick()
        missed, rejected = len(seeds) - len(seen), len(seen) - len(kept)
        self._tally.update(tried=len(seeds), kept=len(kept), missed=missed, rejected=rejected)
        return kept
