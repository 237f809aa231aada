"""Experts that plan each attempt at an episode once, and then command as the plan says."""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

import numpy as np

from dynahoi_lerobot.agent import Expert, WorldState
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import HAND_DOF


class MotionPlan(Protocol):
    """What a hand is going to do in one attempt."""

    def command(self, frame: int, state: np.ndarray) -> np.ndarray:
        """Return (18,) the command of ``frame``, which is where the hand should be one frame later.

        Args:
            frame: of the episode.
            state: (18,) where the hand is now: palm centre [m], world, and joint angles [rad].
        """
        ...


class PlannedExpert(Expert):
    """Plans each attempt of an episode once, from its spec, and keeps the plan of every world until the next."""

    def __init__(self) -> None:
        """Start with no plans."""
        self._plans: dict[int, tuple[EpisodeSpec, int, MotionPlan]] = {}

    @abstractmethod
    def plan(self, spec: EpisodeSpec, attempt: int) -> MotionPlan:
        """Return the plan of the ``attempt``-th try (from 1)."""

    def act(self, world: WorldState) -> np.ndarray:
        """Return (N, 18) commands; worlds without an episode get zeros."""
        commands = np.zeros((len(world.specs), HAND_DOF))
        for i, spec in enumerate(world.specs):
            if spec is not None:
                state = world.observation.state[i].astype(np.float64)
                commands[i] = self._current(i, spec, int(world.attempt[i])).command(int(world.frame[i]), state)
        return commands

    def _current(self, i: int, spec: EpisodeSpec, attempt: int) -> MotionPlan:
        known = self._plans.get(i)
        if known is None or known[0] is not spec or known[1] != attempt:
            known = self._plans[i] = spec, attempt, self.plan(spec, attempt)
        return known[2]
