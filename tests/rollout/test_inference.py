"""Inference that takes time, against timelines computed by hand."""

from collections import deque

import numpy as np
import pytest

from dynahoi_lerobot.core.agent import Agent, Observation
from dynahoi_lerobot.core.conventions import frames_until
from dynahoi_lerobot.core.protocols import one_hot_phase
from dynahoi_lerobot.rollout.inference import (
    Inference,
    RealTimeAgent,
    StepwiseInference,
)

STILL = -1.0


class Clock(Agent):
    """Plans 100 x (frame it sees) + (frame the action is for), a few at a time."""

    name = "clock"
    plans = True
    accepts_guidance = True

    def __init__(self, seconds: tuple[float, float] = (0.0, 0.0), horizon: int = 5) -> None:
        self.seconds = np.array(seconds)
        self.horizon = horizon
        self.calls: list[tuple] = []
        self.reset(2)

    def reset(self, count: int) -> None:
        self.t = 0

    def act(self, observation: Observation) -> np.ndarray:
        raise AssertionError("a chunk was asked for")

    def observe(self, observation: Observation) -> None:
        self.t += 1

    def plan(
        self,
        observation: Observation,
        worlds: np.ndarray,
        *,
        executed: np.ndarray | None = None,
        delays: np.ndarray | None = None,
    ) -> tuple:
        told = [None if values is None else values.tolist() for values in (executed, delays)]
        self.calls.append((self.t, worlds.tolist(), *told))
        actions = 100 * self.t + self.t + np.arange(float(self.horizon))
        self.t += 1
        chunks = np.broadcast_to(actions[None, :, None], (len(worlds), self.horizon, 18))
        return chunks, self.seconds[worlds]


def observation() -> Observation:
    still = np.full((2, 18), STILL, np.float32)
    return Observation({}, still, one_hot_phase(np.ones(2, bool)), ("", ""))


def played(agent: RealTimeAgent, frames: int) -> np.ndarray:
    """(2, frames) what is commanded, as (frame that was seen) x 100 + (frame that it is for)."""
    agent.reset(2)
    return np.array([agent.act(observation())[:, 0] for _ in range(frames)]).T


def test_the_old_chunk_goes_on_until_the_next_is_ready_and_what_is_past_of_that_is_skipped():
    # Inferences begin at frames 0, 3, 6, 9 and are ready three frames later.
    agent = RealTimeAgent(Clock(), Inference("async", 150.0))
    for _ in range(2):  # the second time after a reset
        for world in played(agent, 11):
            assert world.tolist() == [STILL, STILL, STILL, 3, 4, 4, 306, 307, 307, 609, 610]
    assert agent.report() == {"inference_frames": 3.0}


def test_a_measured_latency_is_that_of_each_world():
    # World 0 needs one frame, world 1 two; the histories count every frame.
    clock = Clock(seconds=(0.04, 0.1))
    commands = played(RealTimeAgent(clock, Inference("async", None)), 6)
    assert commands.tolist() == [[STILL, 1, 102, 203, 304, 405], [STILL, STILL, 2, 3, 204, 205]]
    assert clock.calls[:4] == [
        (0, [0, 1], None, [0, 0]),
        (1, [0], None, [1]),
        (2, [0, 1], None, [1, 2]),
        (3, [0], None, [1]),
    ], "an inference is expected to take as long as the last one"


def test_real_time_chunking_tells_what_is_executed_and_how_long_it_will_take():
    clock = Clock()
    played(RealTimeAgent(clock, Inference("rtc", 100.0)), 7)
    # The chunk of frame 0 is ready at frame 2; then two of its actions are past and two will be by
    # the next.
    assert [call[2:] for call in clock.calls] == [
        (None, [2, 2]),
        ([2, 2], [2, 2]),
        ([2, 2], [2, 2]),
        ([2, 2], [2, 2]),
    ]


@pytest.mark.parametrize(
    ("mode", "latency_ms"),
    [("late", 0.0), ("sync", 50.0), ("sync", None), ("async", -1.0), ("async", float("nan"))],
)
def test_impossible_timings_are_refused(mode: str, latency_ms: float | None):
    with pytest.raises(ValueError, match="inference"):
        Inference(mode, latency_ms)


@pytest.mark.parametrize("timing", [Inference("async", 250.0), Inference("rtc", 100.0)])
def test_timings_that_an_agent_does_not_support_are_refused(timing: Inference):
    """A chunk that is over before it is ready, and guidance of an agent that takes none."""
    clock = Clock()
    clock.accepts_guidance = False
    with pytest.raises(ValueError, match="'clock'"):
        played(RealTimeAgent(clock, timing), 1)


@pytest.mark.parametrize(
    ("latency_ms", "frames"), [(0, 0), (1, 1), (50, 1), (51, 2), (150, 3), (370, 8)]
)
def test_a_chunk_is_ready_at_the_first_frame_at_which_its_inference_has_ended(
    latency_ms: float, frames: int
):
    assert frames_until(latency_ms / 1000) == frames


def stepwise(n_action_steps: int, latency_ms: float, frames: int) -> list[float]:
    """What is executed in each frame of a world that plays so many.

    As LeRobot's policies do, this one infers if its queue is empty, and else answers from it
    without a look.
    """
    inference = StepwiseInference(Inference("async", latency_ms), "p", n_action_steps)
    queue = deque[float]()
    executed = list[float]()
    for _ in range(inference.calls(frames)):
        if not queue:
            queue.extend(float(101 * len(executed) + i) for i in range(n_action_steps))
        command = inference.answer(np.full((1, 18), queue.popleft()), np.full((1, 18), STILL))
        executed += [] if command is None else [float(command[0, 0])]
    return executed[:frames]


@pytest.mark.parametrize("latency_ms", [0.0, 50.0, 100.0, 150.0, 300.0])
def test_with_a_queue_the_timing_is_that_of_whole_chunks(latency_ms: float):
    expected = played(RealTimeAgent(Clock(horizon=12), Inference("async", latency_ms)), 30)[0]
    assert stepwise(12, latency_ms, 30) == expected.tolist()


def test_a_new_episode_begins_with_an_inference():
    inference = StepwiseInference(Inference("async", 50.0), "two", 2)
    still = np.full((1, 18), STILL)
    action = np.zeros((1, 18))
    assert [inference.answer(action, still) is None for _ in range(3)] == [True, False, True]
    inference.reset()
    assert inference.answer(action, still) is None
    command = inference.answer(action, still)
    assert command[0, 0] == STILL


@pytest.mark.parametrize(
    ("timing", "n_action_steps", "lookback_frames"),
    [
        (Inference("rtc", 150.0), 6, 0),
        (Inference("async", None), 6, 0),
        (Inference("async", 150.0), 3, 0),
        (Inference("async", 150.0), 6, 4),
    ],
)
def test_timings_that_a_queue_cannot_have_are_refused(
    timing: Inference, n_action_steps: int, lookback_frames: int
):
    with pytest.raises(ValueError, match=r"use async|declare it|'p'"):
        StepwiseInference(timing, "p", n_action_steps, lookback_frames=lookback_frames)
