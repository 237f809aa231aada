"""A policy that is asked for one action a call, against timelines computed by hand and against whole chunks."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from dynahoi_lerobot.agent import ChunkAgent, Observation, Plan
from dynahoi_lerobot.phase import one_hot_phase
from dynahoi_lerobot.rollout.inference import Inference
from dynahoi_lerobot.rollout.real_time_agent import RealTimeAgent
from dynahoi_lerobot.rollout.stepwise_inference import QueuedPolicy, StepwiseInference

STILL = -1.0


class Counter(ChunkAgent):
    """Plans 100 x (frame it sees) + (frame the action is for), 12 at a time; the same with a queue of some of them."""

    name = "counter"

    def __init__(self, policy: QueuedPolicy) -> None:
        self.policy, self.queue, self.seen = policy, deque[float](), list[int]()

    def act(self, observation: Observation) -> np.ndarray:
        raise AssertionError("a chunk was asked for")

    def plan(self, observation: Observation, worlds: np.ndarray, **continued: np.ndarray) -> Plan:
        t = float(observation.state[0, 0])
        return Plan(np.broadcast_to((101 * t + np.arange(12.0))[None, :, None], (1, 12, 18)), np.zeros(1))

    def select_action(self, frame: int) -> np.ndarray:
        """As LeRobot's policies do: infer if the queue is empty, else answer from it without a look."""
        self.seen.append(frame)
        if not self.queue:
            first = 101 * frame + self.policy.skipped_frames
            self.queue.extend(float(first + i) for i in range(self.policy.n_action_steps))
        return np.full((1, 18), self.queue.popleft())


def stepwise(policy: QueuedPolicy, latency_ms: float, frames: int) -> tuple[list[float], list[int]]:
    """What is executed in each frame, and the frame seen in each call, of a world that plays so many frames."""
    counter, inference = Counter(policy), StepwiseInference(policy, Inference("async", latency_ms))
    executed: list[float] = []
    for _ in range(inference.calls(frames)):
        command = inference.answer(counter.select_action(len(executed)), np.full((1, 18), STILL))
        executed += [] if command is None else [float(command[0, 0])]
    return executed[:frames], counter.seen


def test_the_world_stands_still_while_the_queue_is_read_and_moves_in_its_last_calls():
    executed, seen = stepwise(QueuedPolicy("six", 6), 150.0, 9)
    assert executed == [STILL, STILL, STILL, 3, 4, 5, 306, 307, 308]
    assert seen == [0, 0, 0, 0, 1, 2, 3, 3, 3, 3, 4, 5, 6, 6, 6, 6, 7, 8]


def test_a_chunk_that_is_over_is_followed_by_its_last_action():
    executed, _ = stepwise(QueuedPolicy("five", 5), 150.0, 9)
    assert executed == [STILL, STILL, STILL, 3, 4, 4, 306, 307, 307]


def test_a_policy_that_skips_what_is_past_sees_every_frame_once():
    executed, seen = stepwise(QueuedPolicy("skipping", 3, skipped_frames=3, lookback_frames=12), 150.0, 9)
    assert executed == [STILL, STILL, STILL, 3, 4, 5, 306, 307, 308]
    assert seen == list(range(9))


@pytest.mark.parametrize("latency_ms", [0.0, 50.0, 100.0, 150.0, 300.0])
def test_it_is_the_timing_of_whole_chunks(latency_ms: float):
    policy = QueuedPolicy("twelve", 12)
    agent, expected = RealTimeAgent(Counter(policy), Inference("async", latency_ms)), []
    agent.reset(1)
    for frame in range(30):
        state = np.full((1, 18), STILL, np.float32)
        state[0, 0] = frame  # what `Counter.plan` reads
        seen = Observation({}, state, one_hot_phase(np.ones(1, bool)), ("",))
        expected.append(float(agent.act(seen)[0, 1]))
    assert stepwise(policy, latency_ms, 30)[0] == expected


def test_a_new_episode_begins_with_an_inference():
    inference = StepwiseInference(QueuedPolicy("two", 2), Inference("async", 50.0))
    still, action = np.full((1, 18), STILL), np.zeros((1, 18))
    assert [inference.answer(action, still) is None for _ in range(3)] == [True, False, True]
    inference.reset()
    assert inference.answer(action, still) is None
    command = inference.answer(action, still)
    assert command is not None
    assert command[0, 0] == STILL


@pytest.mark.parametrize(
    ("policy", "mode", "latency_ms", "sentence"),
    [
        (
            QueuedPolicy("p", 6),
            "rtc",
            150.0,
            "asked for one action a call; use async, or dynahoi evaluate --inference rtc",
        ),
        (QueuedPolicy("p", 6), "async", None, "declare it in ms, or use dynahoi evaluate --inference-ms measured"),
        (
            QueuedPolicy("p", 3),
            "async",
            150.0,
            r"'p' executes 3 .* 150 ms \(3 frames\); n_action_steps must be at least 4",
        ),
        (QueuedPolicy("p", 2, 3), "async", 150.0, "n_action_steps must be at least 3"),
        (QueuedPolicy("p", 6, 4), "async", 150.0, "'p' skips 4 frames .* allowed are up to 3"),
        (QueuedPolicy("p", 6, 0, 5), "async", 150.0, "'p' looks back 5 frames and would see some twice"),
    ],
)
def test_what_cannot_be_had_is_a_sentence(policy: QueuedPolicy, mode: str, latency_ms: float | None, sentence: str):
    with pytest.raises(ValueError, match=sentence):
        StepwiseInference(policy, Inference(mode, latency_ms))
