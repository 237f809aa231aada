"""A recorder that needs no simulator; other processes import it."""

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import REDRAW_STRIDE
from tests.dataset.episodes import varied_episode


@dataclass(frozen=True)
class FakeRecipe(Recipe):
    image_size: int = 16
    name: str = "fake"
    miss_every: int = 0
    """Every first draw that this divides is missed by the expert; 0 for none."""
    hopeless: bool = False
    """The expert misses everything."""


PLAN = GenerationPlan(FakeRecipe(), 5, shard_episodes=2)
"""Five episodes in three shards."""


def record(recipe: FakeRecipe, seeds: Sequence[int]) -> Iterator[Episode]:
    for seed in seeds:
        first_draw = seed < REDRAW_STRIDE
        if not (
            recipe.hopeless or (recipe.miss_every and first_draw and seed % recipe.miss_every == 0)
        ):
            yield varied_episode(seed, recipe.image_size, recipe.views)


def record_slowly(recipe: FakeRecipe, seeds: Sequence[int]) -> Iterator[Episode]:
    for episode in record(recipe, seeds):
        time.sleep(0.01)
        yield episode


def record_with_nan(recipe: FakeRecipe, seeds: Sequence[int]) -> Iterator[Episode]:
    """Seeds below 100 that end in 3 give a corrupt recording."""
    for episode in record(recipe, seeds):
        if episode.meta.seed % 10 == 3 and episode.meta.seed < 100:
            state = episode.state.copy()
            state[5, 2] = np.nan
            yield replace(episode, state=state)
        else:
            yield episode


def record_and_die_once(recipe: FakeRecipe, seeds: Sequence[int]) -> Iterator[Episode]:
    """The first process that comes here dies in the middle of its shard."""
    marker = Path(recipe.name)
    for number, episode in enumerate(record(recipe, seeds)):
        if number == 1 and not marker.exists():
            marker.touch()
            os._exit(9)
        yield episode


def record_and_die(recipe: FakeRecipe, seeds: Sequence[int]) -> Iterator[Episode]:
    yield from record(recipe, seeds[:1])
    os._exit(9)
