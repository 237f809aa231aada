"""LeRobot's own training learns from on-policy recordings: the tracker's forecast, and ACT with the stock features."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.scripts.lerobot_train import main as lerobot_train
from lerobot_policy_tracker.demonstrated import Demonstrated
from lerobot_policy_tracker.heads.intercept import KNOTS

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.rules import control_class_of
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.onpolicy.test_dagger import tiny_recipe

ACT = ("--policy.chunk_size=4", "--policy.n_action_steps=1", "--policy.dim_model=16", "--policy.n_heads=2")
ACT = (*ACT, "--policy.pretrained_backbone_weights=null", "--policy.dim_feedforward=16", "--policy.type=act")


@pytest.fixture(scope="module")
def recorded(actor: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("recorded") / "d"
    what = ["--episodes", "2", "--motions", "constant,lob", "--control-class", "standard"]
    assert main(["generate", "--root", str(root), "--actor", str(actor), *what]) == 0
    return root


def train(monkeypatch: pytest.MonkeyPatch, root: Path, out: Path, *words: str) -> Path:
    """Make two steps with `lerobot-train`; return the checkpoint."""
    fixed = ("--steps=2", "--batch_size=2", "--num_workers=0", "--env_eval_freq=0", "--seed=0", "--log_freq=1")
    fixed += ("--policy.device=cpu", "--policy.push_to_hub=false", "--policy.repo_id=local/x")
    data = (f"--dataset.root={root}", "--dataset.repo_id=local/d", f"--output_dir={out}")
    monkeypatch.setattr("sys.argv", ["lerobot-train", *data, *fixed, *words])
    lerobot_train()
    return out / "checkpoints" / "last" / "pretrained_model"


@pytest.mark.slow
def test_act_with_the_stock_features_learns_from_it_and_acts(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    checkpoint = train(monkeypatch, recorded, tmp_path / "out", *ACT)
    config = json.loads((checkpoint / "config.json").read_text())
    assert set(config["output_features"]) == {"action"}, "what was executed is not to be learned"
    assert all(key.startswith("observation.") for key in config["input_features"])
    specs = sample_specs(Recipe(split="val", image_size=32), [0])
    (episode,) = evaluate(WorldBatch(Recipe(image_size=32), 1, threads=1), PolicyAgent(str(checkpoint)), specs)
    assert len(episode) > episode.meta.window_frames


@pytest.mark.slow
def test_tracker_learns_its_forecast_from_it(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recipe = yaml.safe_load(tiny_recipe(tmp_path).read_text())
    policy = recipe["policy"] | {"privileged_key": "target.pose", "privileged_weight": 0.0}
    (tmp_path / "train.yaml").write_text(yaml.safe_dump({"dataset": {"repo_id": "local/d"}, "policy": policy}))
    checkpoint = train(monkeypatch, recorded, tmp_path / "out", f"--config_path={tmp_path / 'train.yaml'}")
    assert PolicyAgent(str(checkpoint)).image_size == 32


def test_forecast_labels_are_those_of_the_teacher_and_the_untouched_path(recorded: Path):
    labels, first = Demonstrated(LeRobotDatasetMetadata("local/d", root=recorded), "target.pose"), 0
    for episode in read_episodes(recorded):
        (spec,) = sample_specs(Recipe(control_class="standard", motions=("constant", "lob")), [episode.meta.seed])
        path, free = spec.oracle_path - spec.home_pos_w, int(np.flatnonzero(~episode.localized)[-1]) + 1
        found = labels(first + torch.arange(free), [0])
        times = np.arange(free)[:, None] + np.array(KNOTS)
        known = found.known[:, 0].numpy()
        assert known[: free // 2].sum() > 100
        np.testing.assert_allclose(found.path[:, 0].numpy()[known], path[times[known]], atol=1e-5)
        np.testing.assert_allclose(found.closed[0, 0], spec.reference_joints, atol=1e-6)
        wanted = Intercept().first_meeting(spec, control_class_of("standard"), 1).frame
        watched = np.arange(spec.window_frames)
        assert np.array_equal(found.arrival[watched, 0], wanted - watched), "from home"
        first += len(episode)
