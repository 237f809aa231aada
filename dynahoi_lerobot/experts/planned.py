"""Experts that plan each attempt at an episode once, and then command as the plan says."""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np

from dynahoi_lerobot.agent import Meeting
from dynahoi_lerobot.control_class import ControlClass
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts.base import SingleWorldExpert, WorldView


class MotionPlan(Protocol):
    """What a hand is going to do in one attempt."""

    @property
    def meeting(self) -> Meeting:
        """Where and when the hand meets the target."""
        ...

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
        return self._kept(world.spec, world.attempt).command(world.due_frame, world.state)

    def first_meeting(self, spec: EpisodeSpec, control: ControlClass, attempt: int) -> Meeting:
        """Return the meeting of the attempt's plan."""
        return self._kept(spec, attempt).meeting

    def _kept(self, spec: EpisodeSpec, attempt: int) -> MotionPlan:
        plans = self._plans.setdefault(spec, {})
        if attempt not in plans:
            plans[attempt] = self.plan(spec, attempt)
        return plans[attempt]
