"""``lerobot-eval --env.inference=async``: LeRobot's own command, unchanged, with the timing of `dynahoi evaluate`."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.scripts.lerobot_eval import main as lerobot_eval
from lerobot_env_dynahoi import DynahoiEnvConfig
from lerobot_policy_tracker import TrackerConfig

from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.rollout.inference import Inference
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.rollout.real_time_agent import RealTimeAgent
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

FEATURES = {
    "input_features": {
        "observation.images.ego": PolicyFeature(FeatureType.VISUAL, (3, 32, 32)),
        "observation.state": PolicyFeature(FeatureType.STATE, (18,)),
    },
    "output_features": {"action": PolicyFeature(FeatureType.ACTION, (18,))},
    "normalization_mapping": dict.fromkeys(("VISUAL", "STATE", "ACTION"), NormalizationMode.IDENTITY),
    "device": "cpu",
    "push_to_hub": False,
}


def saved(config: PreTrainedConfig, folder: Path) -> Path:
    """Write a checkpoint with random weights, none of them zero."""
    torch.manual_seed(0)
    policy = get_policy_class(config.type)(config)
    for weight in policy.parameters():
        weight.data += 0.05 * torch.randn_like(weight)
    policy.save_pretrained(folder)
    for pipeline in make_pre_post_processors(config):
        pipeline.save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def act(tmp_path_factory: pytest.TempPathFactory) -> Path:
    small = {"dim_model": 32, "n_heads": 2, "dim_feedforward": 32, "n_encoder_layers": 1, "n_decoder_layers": 1}
    small |= {"use_vae": False, "pretrained_backbone_weights": None}
    return saved(ACTConfig(chunk_size=8, n_action_steps=8, **small, **FEATURES), tmp_path_factory.mktemp("act"))


@pytest.fixture(scope="module")
def tracker(tmp_path_factory: pytest.TempPathFactory) -> Path:
    small = {"width": 16, "n_attention_heads": 2, "backbone_options": {"n_keypoints": 4, "channels": 8}}
    small |= {"head_options": {"n_layers": 1}, "ema_decay": 0.0, "noise_scale": 0.0, "image_size": 32}
    config = TrackerConfig(n_obs_frames=5, obs_stride=1, horizon=8, n_action_steps=4, **small, **FEATURES)
    return saved(config, tmp_path_factory.mktemp("tracker"))


def through_lerobot(policy: Path, out: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> Results:
    words = [f"--policy.path={policy}", "--env.type=dynahoi", "--env.task=constant", "--env.image_size=32"]
    words += [f"--env.results_dir={out}", f"--output_dir={out / 'lerobot'}", "--seed=0"]
    words += ["--eval.batch_size=2", "--eval.n_episodes=2", "--eval.use_async_envs=false", *options]
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", *words])
    lerobot_eval()
    return read_results(out)


def assert_same_as_with_whole_chunks(policy: Path, found: Results) -> None:
    """Play the same episodes as ``dynahoi evaluate --inference async --inference-ms 150`` does, and compare actions."""
    agent = RealTimeAgent(PolicyAgent(str(policy)), Inference("async", 150.0))
    recipe = found.recipe()
    played = evaluate(
        WorldBatch(recipe, 2, threads=1), agent, sample_specs(recipe, sorted(row["seed"] for row in found.rows))
    )
    expected = {episode.meta.seed: episode.action for episode in played}
    assert len(expected) == 2
    for row, actions in zip(found.rows, found.actions, strict=True):
        np.testing.assert_allclose(actions, expected[row["seed"]], atol=1e-6)
        assert np.ptp(actions, axis=0).max() > 0.01, "the hand moves"


LATE = ("--env.latency_ms=150", "--env.inference=async")


def test_a_policy_with_a_queue_plays_the_same_episodes(act: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    found = through_lerobot(act, tmp_path, monkeypatch, *LATE)
    assert_same_as_with_whole_chunks(act, found)
    assert found.info.extra["inference"] == "async 150 ms"


def test_a_policy_with_a_memory_plays_the_same_episodes(tracker: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    skipping = ("--policy.latency_frames=3", "--policy.n_action_steps=3", "--policy.replan_key=")
    found = through_lerobot(tracker, tmp_path, monkeypatch, *LATE, *skipping)
    assert_same_as_with_whole_chunks(tracker, found)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--env.inference=rtc", "--env.latency_ms=150"), "asked for one action a call"),
        (("--env.latency_ms=150",), "with mode sync the world waits; use async or rtc"),
        ((*LATE, "--policy.n_action_steps=2"), "'act' executes 2 actions of a chunk.* must be at least 4"),
        ((*LATE, "--env.n_action_steps=5"), "env.n_action_steps is 5, but the policy's is 8"),
    ],
)
def test_what_lerobots_loop_cannot_do_is_a_sentence(
    act: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], sentence: str
):
    with pytest.raises(ValueError, match=sentence):
        through_lerobot(act, tmp_path, monkeypatch, *options)


def test_a_policy_that_replans_at_other_times_is_a_sentence(
    tracker: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    with pytest.raises(ValueError, match=r"'tracker' infers anew when observation.phase rises"):
        through_lerobot(tracker, tmp_path, monkeypatch, *LATE)


def test_without_a_command_line_the_length_of_the_queue_must_be_told():
    late = {"image_size": 32, "inference": "async", "latency_ms": 150.0, "task": "constant"}
    with pytest.raises(ValueError, match=r"is not told; pass --env\.n_action_steps"):
        DynahoiEnvConfig(**late).create_envs(1)
    env = DynahoiEnvConfig(**late, n_action_steps=6).create_envs(1)["straight_line"][0]
    with pytest.raises(ValueError, match="all worlds begin together"):
        env.reset(seed=[0])
