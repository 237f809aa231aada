"""LeRobot's policies through its own training command and our evaluation: two steps, one episode, no download."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from accelerate.state import AcceleratorState
from lerobot.scripts.lerobot_train import main as lerobot_train

from dynahoi_lerobot.cli import main
from dynahoi_lerobot.evaluate.results import read_results
from tests.zoo.stand_ins import save_clip, save_smolvlm

RECIPES = Path(__file__).parents[2] / "recipes" / "zoo"
SIZE = 64
SMALL = {
    "act": {"pretrained_backbone_weights": None, "dim_model": 32, "n_heads": 2, "dim_feedforward": 32},
    "diffusion": {"pretrained_backbone_weights": None, "use_group_norm": True, "down_dims": [16, 32]},
    "multi_task_dit": {
        "vision_encoder_name": "CLIP",
        "text_encoder_name": "CLIP",
        "image_resize_shape": [SIZE, SIZE],
        "hidden_dim": 32,
        "num_layers": 1,
        "num_heads": 2,
        "num_inference_steps": 2,
    },
    "actiontokens": {"vlm_name": "SMOLVLM", "load_vlm_weights": False},
    "smolvla": {
        "vlm_model_name": "SMOLVLM",
        "load_vlm_weights": False,
        "num_vlm_layers": 2,
        "resize_imgs_with_padding": [32, 32],
        "num_steps": 2,
    },
}
"""What makes each small; folders of stand-ins are filled in."""


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("models")
    folders = {"CLIP": root / "clip", "SMOLVLM": root / "smolvlm"}
    save_clip(folders["CLIP"])
    save_smolvlm(folders["SMOLVLM"])
    return {name: str(folder) for name, folder in folders.items()}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "d"
    words = ["--root", str(root), "--episodes", "2", "--image-size", str(SIZE), "--motions", "constant,lateral"]
    assert main(["generate", *words]) == 0
    return root


@pytest.mark.parametrize("name", SMALL)
def test_two_steps_and_an_episode(
    name: str, models: dict[str, str], data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = {key: models.get(value, value) if isinstance(value, str) else value for key, value in SMALL[name].items()}
    camera = {"observation.images.ego": {"type": "VISUAL", "shape": [3, SIZE, SIZE]}}
    state = {"observation.state": {"type": "STATE", "shape": [18]}}
    policy |= {"device": "cpu", "input_features": camera | state}
    run = {"dataset.root": str(data), "output_dir": str(tmp_path / "out"), "steps": 2, "save_freq": 2, "batch_size": 2}
    run |= {"num_workers": 0, "log_freq": 1} | {f"policy.{key}": value for key, value in policy.items()}
    words = [f"--{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in run.items()]
    AcceleratorState._reset_state(reset_partial_state=True)
    monkeypatch.setattr("sys.argv", ["lerobot-train", f"--config_path={RECIPES / name}.yaml", *words])
    lerobot_train()
    checkpoint = str(tmp_path / "out" / "checkpoints" / "last" / "pretrained_model")
    played = ["--policy", checkpoint, "--motions", "constant", "--episodes", "1", "--out", str(tmp_path / "r")]
    assert main(["evaluate", *played]) == 0
    results = read_results(tmp_path / "r")
    assert len(results.rows) == 1
    assert results.rows[0]["kind"] == "constant"
    assert results.actions[0].shape[1] == 18
