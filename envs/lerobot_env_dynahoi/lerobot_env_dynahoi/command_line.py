"""What LeRobot's command line says, which it does not tell its environments."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from dynahoi_lerobot.evaluate.checkpoint import PolicyError, described_folder, folder_weights, trained_for


def given(argv: Sequence[str]) -> dict[str, str]:
    """Return the options of a command line, ``--name=value`` or ``--name value``, by name."""
    options: dict[str, str] = {}
    for word, following in zip(argv, [*argv[1:], "--"], strict=True):
        name, equals, value = word.removeprefix("--").partition("=")
        if word.startswith("--") and (equals or not following.startswith("--")):
            options[name] = value if equals else following
    return options


def policy_name(argv: Sequence[str]) -> str:
    """Return what is being played: the policy's type, its path, or just ``policy``."""
    options = given(argv)
    path = options.get("policy.path") or options.get("policy.pretrained_path")
    config = Path(path or "") / "config.json"
    if path and config.is_file():
        return str(json.loads(config.read_text()).get("type", path))
    return path or options.get("policy.type", "policy")


def policy_weights(argv: Sequence[str]) -> dict[str, str]:
    """Return the sha256 of the weights of the local checkpoint that ``lerobot-eval`` plays; nothing elsewhere.

    In training the checkpoint of the command line is what training began with.
    """
    options = given(argv)
    path = options.get("policy.path") or options.get("policy.pretrained_path")
    plays = Path(argv[0]).stem.replace("_", "-") == "lerobot-eval"
    return folder_weights(Path(path)) if plays and path else {}


def policy_rules(argv: Sequence[str]) -> dict[str, Any]:
    """Return the rules that the checkpoint of the command line was trained for, see ``trained_for``."""
    options = given(argv)
    path = options.get("policy.path") or options.get("policy.pretrained_path")
    try:
        return trained_for(described_folder(path)) if path else {}
    except PolicyError:
        return {}  # LeRobot says what is wrong with it


def new_results_folder(argv: Sequence[str]) -> Path:
    """Return a folder for an evaluation that begins now: below ``--output_dir``, or ``outputs`` if that is not given.

    The file that ``--config_path`` names may give it, too. A training evaluates several times, so each evaluation has a
    folder of its own.
    """
    options = given(argv)
    config = Path(options.get("config_path", ""))
    told = yaml.safe_load(config.read_text()) if config.is_file() else {}
    folder = Path(options.get("output_dir") or told.get("output_dir") or "outputs")
    return folder / "dynahoi" / datetime.now().strftime("%Y-%m-%d_%H-%M-%S_%f")
