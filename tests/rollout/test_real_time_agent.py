"""One inference at a time, against timelines computed by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from dynahoi_lerobot.agent import ChunkAgent, Observation, Plan
from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.phase import one_hot_phase
from dynahoi_lerobot.rollout.inference import Inference, frames_of
from dynahoi_lerobot.rollout.real_time_agent import RealTimeAgent

STILL = -1.0


class Clock(ChunkAgent):
    """Plans 100 x (frame it sees) + (frame the action is for), five at a time."""

    name = "clock"
    accepts_guidance = True

    def __init__(self, seconds: tuple[float, float] = (0.0, 0.0)) -> None:
        self.seconds = np.array(seconds)
        self.calls: list[tuple] = []
        self.guided = False
        self.reset(2)

    def reset(self, count: int) -> None:
        self.t = 0

    def act(self, observation: Observation) -> np.ndarray:
        raise AssertionError("a chunk was asked for")

    def enable_guidance(self) -> None:
        self.guided = True

    def watch(self, observation: Observation) -> None:
        self.t += 1

    def plan(
        self,
        observation: Observation,
        worlds: np.ndarray,
        *,
        executed: np.ndarray | None = None,
        delays: np.ndarray | None = None,
    ) -> Plan:
        told = [None if values is None else values.tolist() for values in (executed, delays)]
        self.calls.append((self.t, worlds.tolist(), *told))
        actions = 100 * self.t + self.t + np.arange(5.0)
        self.t += 1
        chunks = np.broadcast_to(actions[None, :, None], (len(worlds), 5, 18))
        return Plan(chunks, self.seconds[worlds], [self.t - 1] * len(worlds))

    def corrected(self, worlds: np.ndarray, expectations: Sequence[int], ages: Sequence[int]) -> np.ndarray:
        """What the chunk is for and how old it is, at the frame noted last, as 100 x (frame it saw) + (frame now)."""
        assert [seen + age for seen, age in zip(expectations, ages, strict=True)] == [self.t - 1] * len(worlds)
        return np.repeat([[100.0 * seen + self.t - 1] for seen in expectations], 18, axis=1)


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


def test_without_latency_every_frame_has_its_own_chunk():
    assert played(RealTimeAgent(Clock(), Inference("async", 0.0)), 4)[0].tolist() == [0, 101, 202, 303]


def test_a_measured_latency_is_that_of_each_world():
    # World 0 needs one frame, world 1 two; the histories count every frame.
    clock = Clock(seconds=(0.04, 0.1))
    commands = played(RealTimeAgent(clock, Inference("async", None)), 6)
    assert commands.tolist() == [[STILL, 1, 102, 203, 304, 405], [STILL, STILL, 2, 3, 204, 205]]
    assert clock.calls[:4] == [
        (0, [0, 1], None, None),
        (1, [0], None, None),
        (2, [0, 1], None, None),
        (3, [0], None, None),
    ]


def test_real_time_chunking_tells_what_is_executed_and_how_long_it_will_take():
    clock = Clock()
    played(RealTimeAgent(clock, Inference("rtc", 100.0)), 7)
    # The chunk of frame 0 is ready at frame 2; then two of its actions are past and two will be by the next.
    assert [call[2:] for call in clock.calls] == [(None, [2, 2]), ([2, 2], [2, 2]), ([2, 2], [2, 2]), ([2, 2], [2, 2])]
    assert clock.guided


def test_a_measured_latency_is_expected_to_be_that_of_the_last_inference():
    clock = Clock(seconds=(0.1, 0.1))
    played(RealTimeAgent(clock, Inference("rtc", None)), 5)
    assert [call[2:] for call in clock.calls] == [(None, [0, 0]), ([2, 2], [2, 2]), ([2, 2], [2, 2])]


def test_an_agent_that_plans_from_where_the_hand_will_be_is_told_in_mode_async_as_well():
    clock = Clock()
    clock.accepts_prefix = True
    played(RealTimeAgent(clock, Inference("async", 100.0)), 5)
    assert [call[2:] for call in clock.calls] == [(None, [2, 2]), ([2, 2], [2, 2]), ([2, 2], [2, 2])]
    assert not clock.guided, "guidance is for real-time chunking"


def test_a_correction_replaces_what_is_left_of_the_running_chunk_in_every_frame():
    clock = Clock()
    clock.corrects = True
    for world in played(RealTimeAgent(clock, Inference("async", 150.0, corrected=True)), 11):
        # As without it, but for the frames after a chunk's last action, 5, which it goes beyond.
        assert world.tolist() == [STILL, STILL, STILL, 3, 4, 5, 306, 307, 308, 609, 610]


def test_a_correction_is_of_the_worlds_that_have_a_chunk():
    clock = Clock(seconds=(0.04, 0.1))
    clock.corrects = True
    commands = played(RealTimeAgent(clock, Inference("async", None, corrected=True)), 6)
    assert commands.tolist() == [[STILL, 1, 102, 203, 304, 405], [STILL, STILL, 2, 3, 204, 205]]


def test_an_agent_that_corrects_nothing_is_refused():
    with pytest.raises(ValueError, match=r"'clock' does not correct its chunks .*; leave the correction out"):
        RealTimeAgent(Clock(), Inference("async", 100.0, corrected=True))


def test_a_world_that_waits_needs_no_correction():
    with pytest.raises(ValueError, match="with mode sync the world waits; use async"):
        Inference("sync", 0.0, corrected=True)


def test_the_label_says_that_chunks_are_corrected():
    assert Inference("async", 150.0, corrected=True).label == "async 150 ms, corrected"
    assert Inference("async", None).label == "async measured"


@pytest.mark.parametrize(
    "timing",
    [Inference(), Inference("async", 150.0, corrected=True), Inference("rtc", 12.5), Inference("async", None)],
)
def test_a_label_gives_its_timing_back(timing: Inference):
    assert Inference.from_label(timing.label) == timing


@pytest.mark.parametrize("label", ["async", "async 1e999 ms", "soon 5 ms", "async 5 ms, later", "async .. ms"])
def test_a_label_of_no_timing_is_refused(label: str):
    with pytest.raises(ValueError, match=r"no inference|latency is inf|could not convert"):
        Inference.from_label(label)


def test_a_chunk_that_is_over_before_it_is_ready_is_refused():
    with pytest.raises(ValueError, match=r"'clock' have 5 actions, all of them past .* after 5 frames; allowed"):
        played(RealTimeAgent(Clock(), Inference("async", 250.0)), 1)


def test_an_agent_that_cannot_be_guided_is_refused():
    clock = Clock()
    clock.accepts_guidance = False
    with pytest.raises(ValueError, match="'clock' does not support; use async"):
        RealTimeAgent(clock, Inference("rtc", 100.0))


@pytest.mark.parametrize(("latency_ms", "frames"), [(0, 0), (1, 1), (50, 1), (51, 2), (150, 3), (370, 8)])
def test_a_chunk_is_ready_at_the_first_frame_at_which_its_inference_has_ended(latency_ms: float, frames: int):
    assert frames_of(latency_ms / 1000) == frames


@pytest.mark.parametrize(
    ("mode", "latency_ms", "sentence"),
    [
        ("late", 0.0, "no inference mode 'late'; known are sync, async, rtc"),
        ("sync", 50.0, "use async or rtc"),
        ("sync", None, "use async or rtc"),
        ("async", -1.0, "is -1.0 ms; it must be from 0"),
        ("async", float("nan"), "is nan ms; it must be from 0"),
    ],
)
def test_bad_timing_is_named(mode: str, latency_ms: float | None, sentence: str):
    with pytest.raises(ValueError, match=sentence):
        Inference(mode, latency_ms)


def test_experts_infer_nothing(capsys: pytest.CaptureFixture):
    assert main(["evaluate", "--policy", "hold", "--inference", "async", "--inference-ms", "50"]) == 2
    assert "--inference async needs a policy that plans chunks; 'hold' is an expert" in capsys.readouterr().err
