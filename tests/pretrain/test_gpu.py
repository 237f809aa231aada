"""Pretraining on a stand-in for a GPU: no devices are mixed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest
import torch
from lerobot_policy_obact.eye_training import EyeLearner

from dynahoi_lerobot.pretrain.recipe import read_recipe
from dynahoi_lerobot.pretrain.run_folder import RunFolder
from dynahoi_lerobot.pretrain.snapshots import ImageStream
from dynahoi_lerobot.pretrain.training import Training
from tests.pretrain.stand_in_gpu import OnGpu, stand_in_gpu
from tests.pretrain.test_pretrain import tiny_recipe


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with stand_in_gpu(monkeypatch):
        yield


def test_the_stand_in_refuses_what_a_gpu_refuses(gpu: None):
    there = torch.ones(2, device="cuda")
    with pytest.raises(RuntimeError, match="cuda:0 and on cpu"):
        torch.add(there, torch.ones(2))
    with pytest.raises((RuntimeError, TypeError), match="numpy"):
        there.numpy()


def test_an_eye_on_a_gpu_learns(tmp_path: Path, gpu: None):
    recipe = read_recipe(tiny_recipe(tmp_path, device="cuda"))
    training = Training(recipe, ImageStream(recipe), EyeLearner)
    assert all(training.update(shown) > 0 for shown in islice(ImageStream(recipe)(0), 2))
    assert all(isinstance(weight, OnGpu) for weight in training.learner.module.state_dict().values())


def test_a_run_saved_on_a_gpu_goes_on_without_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = RunFolder(tmp_path, {})
    folder.log({})
    with monkeypatch.context() as patch:
        patch.setattr(torch.serialization, "location_tag", lambda _: "cuda:0")
        folder.save({"weight": torch.ones(2)})
    state = folder.restore()
    assert state is not None
    assert state["weight"].device.type == "cpu"
