"""Plan: which seeds go into which shard. A dataset is a function of (recipe, seed, code)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.generate.codecs.base import Encoding
from dynahoi_lerobot.generate.fingerprint import code_fingerprint
from dynahoi_lerobot.generate.layout import Layout

REDRAW_STRIDE = 1 << 32
"""A slot whose seed fails is drawn again with ``seed + k * REDRAW_STRIDE``, k = 1, 2, ..."""

MAX_DRAWS = 16
"""Draws per slot before the recipe is called impossible."""


class Recipe(Protocol):
    """What generation needs to know of a recipe, a frozen dataclass."""

    seed: int
    episodes: int
    image_size: int | None


class Record(Protocol):
    """Plays the expert: yields the successful episodes among ``seeds``, in their order."""

    def __call__(self, recipe: Any, seeds: Sequence[int], *, workers: int = 1) -> Iterator[Episode]:
        """Yield at most one episode per seed, a deterministic function of (recipe, seed)."""
        ...


Progress = Callable[[int], object]
"""Called now and then with the number of episodes that are done."""


class GenerationError(RuntimeError):
    """The expert cannot make the episodes that the recipe asks for."""


@dataclass(frozen=True)
class Plan:
    """A dataset to be made.

    Episode slot i of the dataset has the seed ``recipe.seed + i``, or a redraw of it. So a dataset that starts
    where another ends shares no seed with it, and the seeds do not depend on the shards.

    Attributes:
        recipe: what to play.
        encoding: how to store pictures.
        shard_episodes: episodes per shard, the unit of work that is made whole or not at all.
        layout: file size limits.
    """

    recipe: Recipe
    encoding: Encoding = field(default_factory=Encoding)
    shard_episodes: int = 256
    layout: Layout = field(default_factory=Layout)

    def __post_init__(self) -> None:
        """Refuse plans that cannot be carried out.

        Raises:
            ValueError: if the number of episodes or of shard episodes is not positive, or the seed out of range.
        """
        if self.recipe.episodes < 1:
            raise ValueError(f"the number of episodes is {self.recipe.episodes}; it must be 1 or more")
        if self.shard_episodes < 1:
            raise ValueError(f"the number of episodes per shard is {self.shard_episodes}; it must be 1 or more")
        if not 0 <= self.recipe.seed <= REDRAW_STRIDE - self.recipe.episodes:
            raise ValueError(f"the seed is {self.recipe.seed}; it must be 0 or more and leave room below 2^32")
        size = self.recipe.image_size
        if size is not None and (size < 16 or (size % 2 and self.encoding.kind.is_video)):
            raise ValueError(f"the image size is {size} pixels; it must be an even number from 16")

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.recipe.episodes // self.shard_episodes)

    def slots(self, shard: int) -> range:
        """Return the first draws of a shard's seeds."""
        first = shard * self.shard_episodes
        last = min(first + self.shard_episodes, self.recipe.episodes)
        return range(self.recipe.seed + first, self.recipe.seed + last)

    def identity(self) -> dict[str, Any]:
        """Return everything that decides the dataset's bytes, as JSON values."""
        content = {
            "recipe": asdict(self.recipe),  # type: ignore[call-overload]
            "encoding": asdict(self.encoding),
            "layout": asdict(self.layout),
            "shard_episodes": self.shard_episodes,
            "code": code_fingerprint(),
        }
        return json.loads(json.dumps(content, default=str))
