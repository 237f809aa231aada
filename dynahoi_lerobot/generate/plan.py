"""The generation plan: which seeds go into which shard. A dataset is a function of (recipe, seed, code)."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import Feature, episode_features
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import REDRAW_STRIDE

Record = Callable[[Any, Sequence[int]], Iterator[Episode]]
"""Plays the expert in a recipe: yields the episodes among the seeds that are to be stored, in their order, at most one
per seed, which is a deterministic function of (recipe, seed)."""
Progress = Callable[[int], object]
"""Called now and then with the number of episodes that are done."""


LARGEST_SHARD = 256
"""Episodes: large enough that starting a shard costs nothing, small enough to redo."""
MAX_SHARD = 65_536
"""Episodes: the seeds of one shard are held in memory."""


def shard_size(episodes: int) -> int:
    """Return how many episodes a shard holds where nothing is said: small datasets, too, keep eight workers busy."""
    return max(1, min(LARGEST_SHARD, -(-episodes // 8)))


@dataclass(frozen=True)
class GenerationPlan:
    """A dataset to be made.

    Episode slot i of the dataset has the seed ``seed + i``, or a redraw of it. So a dataset that starts where
    another ends shares no seed with it, and the seeds do not depend on the shards.

    Attributes:
        recipe: what to play.
        episodes: how many to store.
        seed: the first episode's seed.
        encoding: how to store them.
        limits: file size limits.
        shard_episodes: episodes per shard, the unit of work; an interrupted shard is made again.
        code: fingerprint of the code that plans; other machines must have the same.
        runtime: what else a policy's actions depend on, see ``generate.actor.runtime``; empty without one.
        subtasks: whether to store subtasks as LeRobot's column for language.
    """

    recipe: Recipe
    episodes: int
    seed: int = 0
    encoding: Encoding = field(default_factory=Encoding)
    limits: FileLimits = field(default_factory=FileLimits)
    shard_episodes: int = LARGEST_SHARD
    code: str = field(default_factory=code_fingerprint)
    runtime: str = ""
    subtasks: bool = False

    def __post_init__(self) -> None:
        """Refuse plans that cannot be carried out.

        Raises:
            ValueError: if a number is out of its range.
        """
        if not 1 <= self.episodes <= REDRAW_STRIDE:
            raise ValueError(f"the number of episodes is {self.episodes}; it must be 1 to {REDRAW_STRIDE}")
        if not 1 <= self.shard_episodes <= MAX_SHARD:
            raise ValueError(f"the number of episodes per shard is {self.shard_episodes}; it must be 1 to {MAX_SHARD}")
        if not 0 <= self.seed <= REDRAW_STRIDE - self.episodes:
            raise ValueError(
                f"the seed is {self.seed}; it must be 0 to {REDRAW_STRIDE - self.episodes} for {self.episodes} episodes"
            )
        self.encoding.check_size(self.recipe.image_size)

    @property
    def features(self) -> tuple[Feature, ...]:
        """The columns of the dataset, of the frame table and of the episode table."""
        return (*self.recipe.features(), *episode_features())

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
        return json.loads(json.dumps(asdict(self) | {"recipe": self.recipe.stored()}))
