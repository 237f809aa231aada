"""Make an episode again: from its seed alone, or by stored actions in the world that the seed describes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import draccus
import numpy as np

from dynahoi_lerobot.agent import Agent, Observation
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.rollout.loop import Job, make_batch, play, record
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_spec

Resimulate = Callable[[int], Episode | None]
"""Makes the episode of a seed again, from nothing but its recipe; None if the expert does not manage it."""


class Player(Agent):
    """Repeats given commands and looks at nothing."""

    name = "player"

    def __init__(self, actions: np.ndarray) -> None:
        """Take the (T, 18) commands of one world: palm position [m], home frame, and joint angles [rad]."""
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
    """Return a function that makes the expert's episodes of a recipe again.

    Args:
        recipe: the recipe as the manifest keeps it.
        images: whether to render.
    """
    played = draccus.decode(Recipe, recipe)

    def resimulate(seed: int) -> Episode | None:
        return next(record(played, [seed], images=images), None)

    return resimulate


def replay(recipe: Recipe, seed: int, actions: np.ndarray, *, attempt: int = 1, images: bool = True) -> Episode:
    """Return the episode that commands (T, 18) lead to, played again from its seed.

    Args:
        recipe: what was played.
        seed: of the episode.
        actions: palm positions [m], home frame, and joint angles [rad].
        attempt: the try that was recorded.
        images: whether to render.
    """
    job = Job(0, sample_spec(recipe, seed), len(actions), attempt)
    ((_, episode),) = play(make_batch(recipe, 1), Player(actions), [job], images=images)
    return episode
