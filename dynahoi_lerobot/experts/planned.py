"""Experts that plan each attempt at an episode once, and then command as the plan says."""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts.base import SingleWorldExpert, WorldView


class MotionPlan(Protocol):
    """What a hand is going to do in one attempt."""

    def command(self, frame: int, state: np.ndarray) -> np.ndarray:
        """Return (18,) the command that takes effect at ``frame``: where the hand should be one frame later.

        Args:
            frame: of the episode.
            state: (18,) where the hand is then: palm centre [m], world, and joint angles [rad].
        """
        ...


class PlannedExpert(SingleWorldExpert):
    """Plans from the episode and the attempt alone, and keeps the plans of episodes for as long as they are played."""

    def __init__(self) -> None:
        """Start with no plans."""
        self._plans: WeakKeyDictionary[EpisodeSpec, dict[int, MotionPlan]] = WeakKeyDictionary()

    @abstractmethod
    def plan(self, spec: EpisodeSpec, attempt: int) -> MotionPlan:
        """Return the plan of the ``attempt``-th try (from 1), whose first command takes effect as control starts."""

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        plans = self._plans.setdefault(world.spec, {})
        if world.attempt not in plans:
            plans[world.attempt] = self.plan(world.spec, world.attempt)
        return plans[world.attempt].command(world.due_frame, world.state)
