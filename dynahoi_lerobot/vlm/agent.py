"""A vision-language model as an agent: one request per world for every ten frames of the control phase."""

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
    """Plays what the model answers; where no answer can be played the hand holds still for as long, and it counts."""

    name = "vlm"
    sees_images = True

    def __init__(self, client: VlmClient, *, name: str = "vlm", concurrency: int = 8) -> None:
        """Ask ``client`` with up to ``concurrency`` requests at a time."""
        self.name, self._client = name, client
        self._threads = ThreadPoolExecutor(max_workers=concurrency)
        self._planned: list[deque[np.ndarray]] = []

    def reset(self, count: int) -> None:
        """Forget what was planned."""
        self._planned = [deque() for _ in range(count)]

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) commands; waits for the models that must answer first."""
        images = observation.images[EGO_VIEW]
        asked = [i for i, queue in enumerate(self._planned) if not queue and self._in_play(observation, i)]
        states = observation.state.astype(np.float64)
        answers = self._threads.map(
            lambda i: self._client.plan(observation.tasks[i], states[i], images[i]),
            asked,
        )
        for i, commands in zip(asked, answers, strict=True):
            self._planned[i].extend(np.repeat(states[i][None], HORIZON, axis=0) if commands is None else commands)
        return np.stack(
            [queue.popleft() if queue else state for queue, state in zip(self._planned, states, strict=True)]
        )

    def report(self) -> dict[str, Any]:
        """Return what the requests came to."""
        return {"vlm": self._client.report()}

    @staticmethod
    def _in_play(observation: Observation, i: int) -> bool:
        """Only worlds in the control phase of an episode are asked for; the images of idle ones are black."""
        return bool(observation.phase[i, 0] > 0 and observation.images[EGO_VIEW][i].any())
