"""A declared inference delay: commands come late, and the hand waits for the first."""

from __future__ import annotations

import numpy as np
import pytest

from dynahoi_lerobot.agent import Agent, Observation
from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.rollout.delayed_agent import DelayedAgent


class Clock(Agent):
    """Commands the number of its observation."""

    name = "clock"

    def __init__(self) -> None:
        self.t = 0

    def reset(self, count: int) -> None:
        self.t = 0

    def act(self, observation: Observation) -> np.ndarray:
        self.t += 1
        return np.full((2, 18), float(self.t))


def observation(phase: tuple[int, int] = (1, 1)) -> Observation:
    phases = np.array(phase, np.float32)[:, None]
    return Observation({}, np.full((2, 18), -1, np.float32), np.zeros((2, 30)), phases, ("", ""))


@pytest.mark.parametrize(("delay_ms", "frames"), [(0, 0), (1, 1), (50, 1), (51, 2), (150, 3), (370, 8)])
def test_a_command_takes_effect_so_many_frames_late(delay_ms: float, frames: int):
    agent = DelayedAgent(Clock(), delay_ms)
    for _ in range(2):
        agent.reset(2)
        commanded = [agent.act(observation())[0, 0] for _ in range(12)]
        assert commanded == [-1.0] * frames + list(range(1, 13 - frames))
    assert agent.report() == {"delay_frames": frames}


def test_commands_given_while_observing_are_void_even_if_they_arrive_later():
    agent = DelayedAgent(Clock(), 100)
    phases = [(0, 0), (0, 1), (1, 1), (1, 1), (1, 1)]
    commanded = np.array([agent.act(observation(phase))[:, 0] for phase in phases])
    assert commanded.T.tolist() == [[-1, -1, -1, -1, 3], [-1, -1, -1, 2, 3]]


@pytest.mark.parametrize("delay_ms", [-1, float("nan"), float("inf")])
def test_a_delay_is_a_length_of_time(delay_ms: float):
    with pytest.raises(ValueError, match="must be 0 ms or more, got"):
        DelayedAgent(Clock(), delay_ms)


def test_experts_know_no_delay(capsys: pytest.CaptureFixture):
    assert main(["evaluate", "--policy", "hold", "--delay-ms", "50"]) == 2
    assert "--delay-ms delays policies; 'hold' is an expert" in capsys.readouterr().err
