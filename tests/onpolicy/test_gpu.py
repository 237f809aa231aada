"""Training in memory with a policy on a stand-in for a GPU: no devices are mixed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest
import torch
import yaml
from lerobot_policy_obact.eye_training import EyeTraining
from lerobot_policy_tracker.learner import make_learner
from torch.utils._pytree import tree_map_only

from dynahoi_lerobot.onpolicy.dagger import Dagger
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe, EyeRecipe, read_recipe
from dynahoi_lerobot.onpolicy.run_folder import RunFolder
from dynahoi_lerobot.onpolicy.snapshots import ImageStream
from tests.onpolicy.stand_in_gpu import OnGpu, stand_in_gpu
from tests.onpolicy.test_dagger import tiny_recipe
from tests.onpolicy.test_pretrain import tiny_recipe as tiny_eye_recipe


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with stand_in_gpu(monkeypatch):
        yield


def on_gpu(recipe: Path) -> Path:
    """Let what a recipe trains learn on the GPU."""
    values = yaml.safe_load(recipe.read_text())
    values.get("policy", values)["device"] = "cuda"
    recipe.write_text(yaml.safe_dump(values))
    return recipe


def test_the_stand_in_refuses_what_a_gpu_refuses(gpu: None):
    there = torch.ones(2, device="cuda")
    with pytest.raises(RuntimeError, match="cuda:0 and on cpu"):
        torch.add(there, torch.ones(2))
    with pytest.raises((RuntimeError, TypeError), match="numpy"):
        there.numpy()


@pytest.mark.slow
@pytest.mark.parametrize("inference", [{}, {"mode": "async", "latency_ms": [0.0, 370.0]}], ids=["sync", "async"])
def test_a_policy_on_a_gpu_plays_learns_and_goes_on(tmp_path: Path, gpu: None, inference: dict):
    changes = {"inference": inference, "teacher_share": 0.0, "rounds": 1, "updates": 1}
    recipe = read_recipe(DaggerRecipe, on_gpu(tiny_recipe(tmp_path, **changes)), out=tmp_path / "out")
    learner = make_learner(recipe)
    dagger = Dagger(recipe, learner)
    dagger._round(lambda _: None)
    assert all(isinstance(value, OnGpu) for value in learner.lessons[0].tensors().values())
    state = learner.state_dict()
    resumed = make_learner(recipe)
    resumed.load_state_dict(tree_map_only(torch.Tensor, torch.Tensor.cpu, state))
    assert resumed.learn(1) > 0
    assert all(isinstance(weight, OnGpu) for weight in resumed.policy.state_dict().values())


def test_an_eye_on_a_gpu_learns(tmp_path: Path, gpu: None):
    recipe = read_recipe(EyeRecipe, on_gpu(tiny_eye_recipe(tmp_path)))
    training = EyeTraining(recipe, ImageStream(recipe))
    assert all(training.update(shown) > 0 for shown in islice(ImageStream(recipe)(0), 2))
    assert all(isinstance(weight, OnGpu) for weight in training.eye.state_dict().values())


def test_a_run_saved_on_a_gpu_goes_on_without_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = RunFolder(tmp_path, {})
    folder.log({})
    with monkeypatch.context() as patch:
        patch.setattr(torch.serialization, "location_tag", lambda _: "cuda:0")
        folder.save({"weight": torch.ones(2)})
    state = folder.restore()
    assert state is not None
    assert state["weight"].device.type == "cpu"
