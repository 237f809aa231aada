"""The requests of a model are its latency, and nobody asks it about worlds that have ended."""

from __future__ import annotations

import numpy as np
import pytest

from dynahoi_lerobot.agent import Observation
from dynahoi_lerobot.rollout.inference import Inference
from dynahoi_lerobot.rollout.real_time_agent import RealTimeAgent
from dynahoi_lerobot.vlm import agent as vlm_agent
from dynahoi_lerobot.vlm.agent import VlmAgent
from dynahoi_lerobot.vlm.prompt import HORIZON


class SlowClient:
    """Needs 120 ms, of a clock that nothing else moves, to say: go where the number of the request is."""

    def __init__(self) -> None:
        self.requests, self.seconds = 0, 0.0

    def monotonic(self) -> float:
        return self.seconds

    def plan(self, task: str, state: np.ndarray, image: np.ndarray) -> np.ndarray:
        self.seconds += 0.12
        self.requests += 1
        return np.full((HORIZON, 18), float(self.requests))


def test_a_request_of_120_ms_takes_three_frames_and_ended_worlds_are_not_asked_about(monkeypatch: pytest.MonkeyPatch):
    images = np.ones((2, 8, 8, 3), np.uint8)
    images[1] = 0  # ended
    seen = Observation({"ego": images}, np.zeros((2, 18), np.float32), np.ones((2, 1)), ("", ""))
    client = SlowClient()
    monkeypatch.setattr(vlm_agent, "time", client)
    agent = RealTimeAgent(VlmAgent(client), Inference("async", None))
    agent.reset(2)
    commands = np.array([agent.act(seen)[:, 0] for _ in range(7)])
    assert commands[:, 0].tolist() == [0, 0, 0, 1, 1, 1, 2]
    assert commands[:, 1].tolist() == [0] * 7
    assert client.requests == 3
