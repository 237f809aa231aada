"""What a policy must offer to learn while it acts; its package has a module ``learner`` that builds one."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dynahoi_lerobot.core.agent import ChunkAgent, Observation

if TYPE_CHECKING:
    from dynahoi_lerobot.onpolicy.rounds import Round


class Student(Protocol):
    """Moves the hands of N worlds."""

    def reset(self, count: int) -> None:
        """Forget everything; ``count`` episodes begin."""

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) commands: palm position [m], home frame, and joint angles [rad] for the next frame."""
        ...


class Learner(ChunkAgent):
    """A policy that can be taught while it acts."""

    @abstractmethod
    def study(self, played: Round) -> None:
        """Keep a round that was just acted, with what was seen in it, to learn from it."""

    @abstractmethod
    def learn(self, updates: int) -> float:
        """Update the policy from the rounds kept; return the mean loss.

        Raises:
            FloatingPointError: if the loss is not finite.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """Return all that learning goes on from."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""

    @abstractmethod
    def save_pretrained(self, folder: Path) -> None:
        """Write a LeRobot checkpoint for acting."""
