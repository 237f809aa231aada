"""What docs/lerobot.md says of image transforms and of tdmpc: LeRobot trains them for two steps."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main

CASES = {
    "image transforms": ["act", "--dataset.image_transforms.enable=true", "--policy.pretrained_backbone_weights=null"],
    "tdmpc": ["tdmpc"],
}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "d"
    assert main(["generate", "--root", str(root), "--episodes", "2", "--image-size", "64"]) == 0
    return root


@pytest.mark.slow  # LeRobot takes long to import
@pytest.mark.parametrize("case", CASES)
def test_lerobot_trains_two_steps(case: str, data: Path, tmp_path: Path):
    from tests.docs.playing import run

    policy, *more = CASES[case]
    words = [f"--policy.type={policy}", "--policy.device=cpu", "--policy.push_to_hub=false", *more]
    words += ["--dataset.repo_id=local/d", f"--dataset.root={data}", f"--output_dir={tmp_path / 'out'}"]
    run(["lerobot-train", *words, "--steps=2", "--batch_size=2", "--num_workers=0", "--env_eval_freq=0"])
    assert (tmp_path / "out/checkpoints/last/pretrained_model/model.safetensors").is_file()
