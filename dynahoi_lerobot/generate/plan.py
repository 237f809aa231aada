"""The generation plan: which seeds go into which shard. A dataset is a function of (recipe, seed, code)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.feature import Feature
from dynahoi_lerobot.features import episode_features, frame_features
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.sampling.redraws import REDRAW_STRIDE
from dynahoi_lerobot.sampling.salt import sealed


class Recipe(Protocol):
    """What generation needs to know of a recipe, a frozen dataclass."""

    image_size: int
    views: tuple[str, ...]
    capture: str

    @property
    def on_policy(self) -> bool:
        """Whether a teacher labels what somebody else does."""
        ...


class Record(Protocol):
    """Plays the expert: yields the episodes among ``seeds`` that are to be stored, in their order."""

    def __call__(self, recipe: Any, seeds: Sequence[int], /) -> Iterator[Episode]:
        """Yield at most one episode per seed, a deterministic function of (recipe, seed)."""
        ...


Progress = Callable[[int], object]
"""Called now and then with the number of episodes that are done."""


class GenerationError(RuntimeError):
    """The expert cannot make the episodes that the recipe asks for."""


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
        camera: whether to store images, of the recipe's size.
        encoding: how to store them.
        shard_episodes: episodes per shard, the unit of work; an interrupted shard is made again.
        limits: file size limits.
        code: fingerprint of the code that plans; other machines must have the same.
        runtime: what else a policy's actions depend on, see ``onpolicy.actor.runtime``; empty without one.
        environment_state: whether to store the simulator's truth as ``observation.environment_state``.
        subtasks: whether to store subtasks as LeRobot's column for language.
    """

    recipe: Recipe
    episodes: int
    seed: int = 0
    camera: bool = True
    encoding: Encoding = field(default_factory=Encoding)
    shard_episodes: int = LARGEST_SHARD
    limits: FileLimits = field(default_factory=FileLimits)
    code: str = field(default_factory=code_fingerprint)
    runtime: str = ""
    environment_state: bool = False
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
        size = self.image_size
        if size is not None and (size < 16 or (size % 2 and self.encoding.is_video)):
            raise ValueError(f"the image size is {size} pixels; it must be an even number from 16")

    @property
    def image_size(self) -> int | None:
        """Side of the images [pixels], None without a camera."""
        return self.recipe.image_size if self.camera else None

    @property
    def features(self) -> tuple[Feature, ...]:
        """The columns of the dataset, of the frame table and of the episode table."""
        contact_sensors = CAPTURES[self.recipe.capture].uses_contact_sensors
        frames = frame_features(
            self.image_size,
            self.recipe.views,
            contact_sensors=contact_sensors,
            environment_state=self.environment_state,
        )
        return (*frames, *episode_features(on_policy=self.recipe.on_policy))

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
        content = {
            "recipe": sealed(asdict(self.recipe)),  # type: ignore[call-overload]
            "episodes": self.episodes,
            "seed": self.seed,
            "camera": self.camera,
            "encoding": asdict(self.encoding),
            "limits": asdict(self.limits),
            "shard_episodes": self.shard_episodes,
            "code": self.code,
            "runtime": self.runtime,
            "environment_state": self.environment_state,
            "subtasks": self.subtasks,
        }
        return json.loads(json.dumps(content, default=str))
