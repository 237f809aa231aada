"""A vision-language model as an agent: one decision per world for every ten frames of the control phase."""

from collections import deque
from typing import Any

import numpy as np

from dynahoi_lerobot.core.agent import ChunkAgent, Observation
from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.core.rules import is_acting
from dynahoi_lerobot.vlm.client import VlmClient
from dynahoi_lerobot.vlm.prompt import HORIZON


class VlmAgent(ChunkAgent):
    """Executes the action chunks that a model answers with.

    After a failed decision the hand holds its pose for as many frames as a chunk has, and the failure is counted.
    """

    sees_images = True

    def __init__(self, client: VlmClient, *, name: str = "vlm") -> None:
        """Ask ``client`` about all worlds that need a chunk at the same time."""
        self.name, self._client = name, client
        self._planned: list[deque[np.ndarray]] = []

    def reset(self, count: int) -> None:
        """Drop the chunks of earlier episodes; ``count`` new episodes begin."""
        self._planned = [deque() for _ in range(count)]

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) commands, palm centre [m], home frame, and joints [rad], once the decisions due are made."""
        in_play = is_acting(observation.phase) & observation.images[EGO_VIEW].any(axis=(1, 2, 3))  # others are black
        due = [i for i, queue in enumerate(self._planned) if not queue and in_play[i]]
        states = observation.state.astype(np.float64)
        chunks, _ = self.plan(observation, np.array(due, int))
        for i, commands in zip(due, chunks, strict=True):
            self._planned[i].extend(commands)
        return np.stack(
            [queue.popleft() if queue else state for queue, state in zip(self._planned, states, strict=True)]
        )

    def plan(
        self,
        observation: Observation,
        worlds: np.ndarray,
        *,
        executed: np.ndarray | None = None,
        delays: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a chunk for each of ``worlds`` (n,) and the seconds that each decision took.

        Worlds whose episode has ended are skipped.
        """
        shown = [i for i in worlds.tolist() if observation.images[EGO_VIEW][i].any()]
        actions = np.repeat(observation.state[:, None].astype(np.float64), HORIZON, axis=1)
        seconds = np.zeros(len(observation.state))
        asked = [(observation.tasks[i], actions[i, 0], observation.images[EGO_VIEW][i]) for i in shown]
        for i, (commands, took) in zip(shown, self._client.plan(asked), strict=True):
            seconds[i] = took
            if commands is not None:
                actions[i] = commands
        return actions[worlds], seconds[worlds]

    def report(self) -> dict[str, Any]:
        """Return the account of the client under ``vlm``."""
        return {"vlm": self._client.report()}
