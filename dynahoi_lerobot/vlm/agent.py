"""A vision-language model as an agent: one decision per world for every ten frames of the control phase."""

from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from dynahoi_lerobot.agent import Agent, Observation
from dynahoi_lerobot.foundation.conventions import EGO_VIEW
from dynahoi_lerobot.vlm.client import VlmClient
from dynahoi_lerobot.vlm.prompt import HORIZON


class VlmAgent(Agent):
    """Executes the action chunks that a model answers with.

    After a failed decision the hand holds its pose for as many frames as a chunk has, and the failure is counted.
    """

    name = "vlm"
    sees_images = True

    def __init__(self, client: VlmClient, *, name: str = "vlm", concurrency: int = 8) -> None:
        """Use ``client`` for up to ``concurrency`` decisions at a time."""
        self.name, self._client = name, client
        self._threads = ThreadPoolExecutor(max_workers=concurrency)
        self._planned: list[deque[np.ndarray]] = []

    def reset(self, count: int) -> None:
        """Drop the chunks of earlier episodes; ``count`` new episodes begin."""
        self._planned = [deque() for _ in range(count)]

    def act(self, observation: Observation) -> np.ndarray:
        """Return the next command of each world, after waiting for the decisions that are due.

        Returns:
            (N, 18) palm centre position [m], home frame, and joint angles [rad].
        """
        images = observation.images[EGO_VIEW]
        due = [i for i, queue in enumerate(self._planned) if not queue and self._in_play(observation, i)]
        states = observation.state.astype(np.float64)
        answers = self._threads.map(
            lambda i: self._client.plan(observation.tasks[i], states[i], images[i]),
            due,
        )
        for i, commands in zip(due, answers, strict=True):
            self._planned[i].extend(np.repeat(states[i][None], HORIZON, axis=0) if commands is None else commands)
        return np.stack(
            [queue.popleft() if queue else state for queue, state in zip(self._planned, states, strict=True)]
        )

    def report(self) -> dict[str, Any]:
        """Return the account of the client under ``vlm``."""
        return {"vlm": self._client.report()}

    @staticmethod
    def _in_play(observation: Observation, i: int) -> bool:
        """Return whether world ``i`` is in the control phase of an episode; the images of idle worlds are black."""
        return bool(observation.phase[i, 0] > 0 and observation.images[EGO_VIEW][i].any())
