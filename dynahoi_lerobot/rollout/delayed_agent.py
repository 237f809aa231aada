"""Inference takes time, and the world moves on meanwhile: an agent whose commands take effect late."""

from __future__ import annotations

from collections import deque
from math import ceil
from typing import Any

import numpy as np

from dynahoi_lerobot.agent import Agent, Observation
from dynahoi_lerobot.foundation.conventions import CONTROL_DT


class DelayedAgent(Agent):
    """Executes every command a whole number of frames after the observation that it answers.

    Commands given while observing are void, as they are without a delay; until the first other one arrives the hand
    holds still. A command is due at the first frame at which it is there: 150 ms are three frames, 370 ms are eight.
    """

    def __init__(self, agent: Agent, delay_ms: float) -> None:
        """Delay ``agent`` by ``delay_ms`` milliseconds.

        Raises:
            ValueError: if the delay is negative.
        """
        if not 0 <= delay_ms < float("inf"):
            raise ValueError(f"the inference delay must be 0 ms or more, got {delay_ms}")
        self.frames = ceil(delay_ms / 1000 / CONTROL_DT - 1e-9)
        self.name, self.sees_images = agent.name, agent.sees_images
        self.image_size, self.views = agent.image_size, agent.views
        self._agent, self._pending = agent, deque[tuple[np.ndarray, np.ndarray]]()

    def reset(self, count: int) -> None:
        """Forget everything, also what is on its way."""
        self._agent.reset(count)
        self._pending.clear()

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) the commands that are due."""
        self._pending.append((self._agent.act(observation), observation.phase > 0))
        still = observation.state.astype(np.float64)
        if len(self._pending) <= self.frames:
            return still
        command, valid = self._pending.popleft()
        return np.where(valid, command, still)

    def report(self) -> dict[str, Any]:
        """Return the agent's report and the delay in frames."""
        return {**self._agent.report(), "delay_frames": self.frames}
