"""Through LeRobot's own commands: train, resume, open, fine-tune."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from lerobot.scripts.lerobot_train import main
from obact_helpers import TINY


def arguments(root: Path, out: Path, **changes: object) -> list[str]:
    tiny = [f"--policy.{key}={json.dumps(value)}" for key, value in TINY.items() if not isinstance(value, str)]
    values = {
        "dataset.repo_id": "local/tiny",
        "dataset.root": root,
        "output_dir": out,
        "policy.type": "obact",
    }
    values |= {
        "policy.device": "cpu",
        "batch_size": 4,
        "steps": 2,
        "save_freq": 2,
        "num_workers": 0,
        "env_eval_freq": 0,
    }
    values |= {"log_freq": 1, "seed": 1} | changes
    return [f"--{key}={value}" for key, value in values.items() if value is not None] + tiny


def lerobot_train(monkeypatch: pytest.MonkeyPatch, args: list[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["lerobot-train", *args])
    main()


def test_train_checkpoint_opens_and_acts(hand_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lerobot_train(monkeypatch, arguments(hand_root, tmp_path / "run"))
    checkpoint = tmp_path / "run/checkpoints/last/pretrained_model"
    assert checkpoint.is_dir()
