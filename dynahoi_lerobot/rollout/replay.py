"""Play stored actions again in the world their seed describes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import draccus
import numpy as np

from dynahoi_lerobot.agent import Agent, Observation
from dynahoi_lerobot.episode import Episode, EpisodeMeta
from dynahoi_lerobot.rollout.loop import Job, make_batch, play
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_spec

Resimulate = Callable[[EpisodeMeta, np.ndarray], tuple[np.ndarray, dict[str, np.ndarray]]]
"""Plays (T, 18) actions in the episode's world; returns (T, 18) states and (T, H, W, 3) images by view."""


class Player(Agent):
    """Repeats given commands and looks at nothing."""

    name = "player"

    def __init__(self, actions: np.ndarray) -> None:
        """Take the (T, 18) commands of one world: palm position [m] world and joint angles [rad]."""
        self._actions = actions
        self._frame = 0

    def reset(self, count: int) -> None:
        """Start from the first command."""
        self._frame = 0

    def act(self, observation: Observation) -> np.ndarray:
        """Return (1, 18), the next command."""
        command = self._actions[self._frame]
        self._frame += 1
        return command[None].astype(np.float64)


def simulator(recipe: dict[str, Any], *, images: bool) -> Resimulate:
    """Return a function that replays episodes of a recipe.

    Args:
        recipe: the recipe as the manifest keeps it.
        images: whether to render.
    """
    played = draccus.decode(Recipe, recipe)

    def resimulate(meta: EpisodeMeta, actions: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        episode = replay(played, meta.seed, actions, attempt=meta.attempts, images=images)
        return episode.state, episode.images

    return resimulate


def replay(recipe: Recipe, seed: int, actions: np.ndarray, *, attempt: int = 1, images: bool = True) -> Episode:
    """Return the episode that commands (T, 18) lead to, played again from its seed.

    Args:
        recipe: what was played.
        seed: of the episode.
        actions: palm positions [m] world and joint angles [rad].
        attempt: the try that was recorded.
        images: whether to render.
    """
    job = Job(0, sample_spec(recipe, seed), len(actions), attempt)
    ((_, episode),) = play(make_batch(recipe, 1), Player(actions), [job], images=images)
    return episode
