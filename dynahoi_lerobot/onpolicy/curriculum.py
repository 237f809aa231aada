"""Which episodes a run plays: new ones as long as there are any, then more of the kinds of motion that fail most."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe
from dynahoi_lerobot.sampling.sampler import sample_specs

MEMORY = 0.9
"""Share of what is known of a kind that counts after one more round."""
PRIOR = 1.0
"""A kind counts as having been caught, and as having been missed, so many times more than it was."""


def failure_rate[N: (float, np.ndarray)](caught: N, missed: N) -> N:
    """Return the expected share of misses after so many catches and misses; one half after none."""
    return (missed + PRIOR) / (caught + missed + 2 * PRIOR)


class Curriculum:
    """Hands out the episodes of each round, and is told how they went.

    Args:
        recipe: what is played, and in how many worlds.
        rng: source of every draw.
    """

    def __init__(self, recipe: DaggerRecipe, rng: np.random.Generator) -> None:
        self.recipe, self._rng = recipe, rng
        self._kinds = np.array(recipe.episodes.motion_names)
        self._caught, self._missed = np.zeros(len(self._kinds)), np.zeros(len(self._kinds))
        self._specs: dict[int, EpisodeSpec] = {}

    def episodes(self, number: int) -> list[EpisodeSpec]:
        """Return the episodes of round ``number``, from 0: new ones in order, or else a weighted draw from all."""
        recipe, first = self.recipe, number * self.recipe.worlds
        if first + recipe.worlds <= recipe.n_episodes:
            seeds = np.arange(first, first + recipe.worlds)
        else:
            seeds = np.sort(self._rng.choice(recipe.n_episodes, recipe.worlds, replace=False, p=self._odds()))
        missing = [int(seed) for seed in seeds if int(seed) not in self._specs]
        self._specs |= zip(missing, sample_specs(recipe.episodes, missing), strict=True)
        return [self._specs[int(seed)] for seed in seeds]

    def note(self, played: Iterable[Episode]) -> None:
        """Count successes and failures of the student; older rounds count less and less."""
        self._caught *= MEMORY
        self._missed *= MEMORY
        for episode in played:
            (self._caught if episode.success else self._missed)[self._kinds == episode.meta.motion] += 1

    def failure_rates(self) -> dict[str, float]:
        """Return the expected share of misses by kind of motion."""
        rates = failure_rate(self._caught, self._missed)
        return dict(zip(self._kinds.tolist(), rates.tolist(), strict=True))

    def state_dict(self) -> dict[str, Any]:
        """Return what is known of the kinds."""
        return {"caught": self._caught.tolist(), "missed": self._missed.tolist()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._caught, self._missed = np.array(state["caught"]), np.array(state["missed"])

    def _odds(self) -> np.ndarray:
        """Probability of each of the run's episodes; seed s is of kind s modulo their number (`sample_specs`)."""
        rates = np.array(list(self.failure_rates().values()))
        odds = rates[np.arange(self.recipe.n_episodes) % len(rates)]
        return odds / odds.sum()
