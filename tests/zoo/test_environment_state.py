"""State-only baselines: the simulator's truth on request, in datasets, environments and evaluations."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.scripts.lerobot_eval import main as lerobot_eval

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.env import register_envs
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.report.entries import unique_labels
from tests.checkpoints import FEATURES, saved

KEY = "observation.environment_state"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "d"
    words = ["--root", str(root), "--episodes", "2", "--image-size", "0", "--motions", "constant,lob"]
    assert main(["generate", *words, "--environment-state"]) == 0
    return root


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> str:
    small = {"dim_model": 32, "n_heads": 2, "dim_feedforward": 32, "n_encoder_layers": 1, "n_decoder_layers": 1}
    inputs = {KEY: PolicyFeature(FeatureType.ENV, (13,)), "observation.state": PolicyFeature(FeatureType.STATE, (18,))}
    config = ACTConfig(chunk_size=4, n_action_steps=4, use_vae=False, **small, **FEATURES | {"input_features": inputs})
    config.normalization_mapping = dict.fromkeys(("ENV", "STATE", "ACTION"), NormalizationMode.IDENTITY)
    return str(saved(config, tmp_path_factory.mktemp("act")))


def test_a_dataset_holds_it_on_request_and_lerobot_reads_it(data: Path) -> None:
    dataset = LeRobotDataset("local/d", root=data, delta_timestamps={KEY: [-0.05, 0.0]})
    (first, _) = read_episodes(data)
    expected = np.concatenate([first.target_pose, first.target_velocity], axis=1)
    np.testing.assert_array_equal(dataset[3][KEY], expected[2:4])
    assert dataset.meta.features[KEY]["names"][:4] == ["x", "y", "z", "qw"]
    assert set(dataset.meta.stats[KEY]) >= {"mean", "std", "min", "max"}
    assert main(["verify", str(data)]) == 0


def test_an_environment_shows_it_on_request() -> None:
    register_envs()
    options = {"image_size": 0}
    env = gym.make("dynahoi/constant-v0", environment_state=True, **options)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    batch = env.unwrapped._vector._batch
    truth = np.concatenate([batch.target_pose[0], batch.target_velocity[0]])
    np.testing.assert_allclose(observation["environment_state"], truth, atol=1e-6)
    blind = gym.make("dynahoi/constant-v0", **options)
    assert "environment_state" not in blind.reset(seed=0)[0]
    assert "environment_state" not in blind.observation_space.spaces


def test_a_policy_that_reads_it_is_evaluated_on_request_and_marked(checkpoint, tmp_path, capsys):
    words = ["evaluate", "--policy", checkpoint, "--motions", "constant", "--episodes", "1", "--out", f"{tmp_path}/r"]
    assert main(words) != 0
    assert "add --environment-state to let it" in capsys.readouterr().err
    assert main([*words, "--environment-state"]) == 0
    assert f"{checkpoint} (privileged)" in capsys.readouterr().out
    results = read_results(tmp_path / "r")
    assert len(results.rows) == 1
    assert unique_labels([results])[0].endswith("(privileged)")
    assert results.privileged


def test_it_is_no_actor_of_recordings(checkpoint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", "--actor", checkpoint, "--episodes", "1", "--root", str(tmp_path / "d")]) == 2
    assert f"reads {KEY}, the simulator's truth; an actor sees images and the hand" in capsys.readouterr().err
    assert not (tmp_path / "d").exists()


def test_lerobot_evaluates_it(checkpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    env = ["--env.type=dynahoi", "--env.task=constant", "--env.environment_state=true", "--env.image_size=16"]
    run = [f"--output_dir={tmp_path / 'out'}", f"--env.results_dir={tmp_path / 'r'}"]
    episodes = ["--eval.n_episodes=1", "--eval.batch_size=1", "--policy.device=cpu"]
    monkeypatch.setattr("sys.argv", ["lerobot-eval", f"--policy.path={checkpoint}", *env, *run, *episodes])
    lerobot_eval()
    results = read_results(tmp_path / "r")
    assert (len(results.rows), results.privileged) == (1, True)
