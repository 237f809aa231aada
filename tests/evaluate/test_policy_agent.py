"""A checkpoint as an agent: its config is changed on request, and it remembers the frames it is
shown.
"""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.lerobot_internals import queued_frame
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent, PolicyError
from dynahoi_lerobot.evaluate.results import read_results
from tests.checkpoints import SHIPPED, tiny_diffusion
from tests.tools import dynahoi
from tests.world.playing import world

CHECKPOINT = str(SHIPPED)


def test_settings_change_the_config_and_nothing_else() -> None:
    plain = PolicyAgent(CHECKPOINT)._policy.config
    changed = PolicyAgent(
        CHECKPOINT, settings=["n_action_steps=2", "inference_delay=3"]
    )._policy.config
    assert (plain.n_action_steps, plain.inference_delay) == (1, 0)
    assert (changed.n_action_steps, changed.inference_delay) == (2, 3)
    assert {**changed.__dict__, "n_action_steps": 1, "inference_delay": 0} == plain.__dict__


@pytest.mark.parametrize("mode", ["async", "rtc"])
def test_a_measured_inference_is_of_one_world_and_may_outlast_the_chunk_before(
    mode, actor, tmp_path, monkeypatch
):
    plan = PolicyAgent.plan
    worlds = []

    def slow(
        agent: PolicyAgent, observation: Observation, chosen: np.ndarray, **told: Any
    ) -> tuple:
        worlds.append(len(observation.state))
        return plan(agent, observation, chosen, **told)[0], np.full(
            1, 0.55
        )  # its chunks are of 8 frames, 0.4 s

    monkeypatch.setattr(PolicyAgent, "plan", slow)
    words = ["--split=val", "--episodes=2", "--control-class=unlimited"]
    words += [f"--inference={mode}", "--inference-ms=measured"]
    dynahoi("evaluate", "--policy", actor, *words, "--out", tmp_path)
    assert set(worlds) == {1}
    assert read_results(tmp_path).info.extra["inference_frames"] == 11.0


def test_a_policy_plays_on_without_the_worlds_that_have_ended(specs):
    seen = world(specs[:3], image_size=96)
    agent = PolicyAgent(CHECKPOINT)
    whole = PolicyAgent(CHECKPOINT)
    for one in (agent, whole):
        one.reset(3)
        one.act(seen.observe())
    agent.leave(np.array([0]))
    seen.step(seen.executed)
    commands, all_commands = (one.act(seen.observe()) for one in (agent, whole))
    np.testing.assert_array_equal(commands[1:], all_commands[1:])
    assert not commands[0].any()
    agent.leave(np.array([2]))
    seen.step(seen.executed)
    np.testing.assert_array_equal(agent.act(seen.observe())[1], whole.act(seen.observe())[1])


def test_guidance_continues_what_is_left_of_a_chunk_or_where_it_led(specs, monkeypatch):
    agent = PolicyAgent(CHECKPOINT)
    observation = world(specs[:1], image_size=96).observe()
    left = []
    agent.reset(1)
    (chunk,), _ = agent.plan(observation, np.array([0]))
    predict = agent._policy.predict_action_chunk

    def watched(batch: dict, **told: Any) -> torch.Tensor:
        left.append(told["prev_chunk_left_over"].shape[1])
        return predict(batch, **told)

    monkeypatch.setattr(agent._policy, "predict_action_chunk", watched)
    for executed in (2, 99):
        agent.plan(observation, np.array([0]), executed=np.array([executed]), delays=np.array([1]))
    assert left == [len(chunk) - 2, 1]


@pytest.mark.parametrize(
    "setting",
    [
        "delay=3",
        "inference_delay",
        "n_action_steps=9",
        "inference_delay=few",
        "embodiment.delay=3",
        "head_options.n_draws=4",
    ],
)
def test_what_cannot_be_set_is_named(setting: str) -> None:
    with pytest.raises(PolicyError, match=f"cannot set '?{setting}"):
        PolicyAgent(CHECKPOINT, settings=[setting])


def test_a_field_of_a_dataclass_in_the_config_can_be_set() -> None:
    trained = PolicyAgent(CHECKPOINT)._policy.config.embodiment
    told = PolicyAgent(CHECKPOINT, settings=["embodiment.delay_frames=3"])._policy.config.embodiment
    assert trained.delay_frames == 0
    assert told == replace(trained, delay_frames=3)


def test_diffusion_policy_plans_from_the_noted_frames(tmp_path: Path) -> None:
    diffusion = DiffusionPolicy.from_pretrained(tiny_diffusion(tmp_path / "policy"))
    shapes = {"observation.environment_state": (2, 13), "observation.state": (2, 18)}
    no_action = {"action": None}  # LeRobot's preprocessor leaves this key in every batch
    frames = [
        {key: torch.rand(shape) for key, shape in shapes.items()} | no_action for _ in range(3)
    ]
    noise = torch.randn(2, 8, 18)
    asked_always = copy.deepcopy(diffusion)
    asked_once = copy.deepcopy(diffusion)
    for frame in frames:
        asked_always.select_action(dict(frame))
    for frame in frames[:-1]:
        queued_frame(asked_once, frame)
    chunk = asked_once.predict_action_chunk(queued_frame(asked_once, frames[-1]), noise=noise)

    expected = asked_always.predict_action_chunk(dict(frames[-1]), noise=noise)
    assert chunk.shape == (2, 4, 18)
    torch.testing.assert_close(chunk, expected)
    forgetful = copy.deepcopy(diffusion)
    other = forgetful.predict_action_chunk(queued_frame(forgetful, frames[-1]), noise=noise)
    assert not torch.allclose(chunk, other), "the frames before matter"
    assert queued_frame(object(), frames[0]) is frames[0], "of a policy without queues"
