"""What LeRobot's command line says of the policy: LeRobot makes an env first and does not pass the
policy to it.
"""

import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import draccus
from lerobot.configs import PreTrainedConfig, parser

from dynahoi_lerobot.core.features import IMAGE_PREFIX
from dynahoi_lerobot.core.reading import ReadError, read_object, read_yaml
from dynahoi_lerobot.evaluate.checkpoint import (
    CONFIG,
    described_folder,
    folder_weights,
    trained_for,
)
from dynahoi_lerobot.renderers.views import OPTIONAL_VIEWS
from dynahoi_lerobot.rollout.inference import QueuedPolicy


def _policy_path() -> str | None:
    return parser.parse_arg("policy.path") or parser.parse_arg("policy.pretrained_path")


def policy_name() -> str:
    """Return what is being played: the policy's type, its path, or just ``policy``."""
    path = _policy_path()
    config = Path(path or "") / "config.json"
    if path and config.exists():
        return str(read_object(config).get("type", path))
    return path or parser.get_type_arg("policy") or "policy"


def policy_weights() -> dict[str, str]:
    """Return the sha256 of the weights of the local checkpoint that ``lerobot-eval`` plays; nothing
    elsewhere.

    In training the checkpoint of the command line is what training began with.
    """
    path, plays = _policy_path(), Path(sys.argv[0]).stem.replace("_", "-") == "lerobot-eval"
    return folder_weights(Path(path)) if plays and path else {}


def policy_rules() -> dict[str, Any]:
    """Return the views and the rules that the checkpoint of the command line was trained for, see
    ``trained_for``.
    """
    if (path := _policy_path()) is None:
        return {}
    try:
        rules = trained_for(folder := described_folder(path))
        inputs = read_object(folder / CONFIG).get("input_features", {})
    except ReadError:
        return {}  # LeRobot says what is wrong with it
    views = [view for view in OPTIONAL_VIEWS if IMAGE_PREFIX + view in inputs]
    return rules | ({"views": views} if views else {})


def new_results_folder() -> Path:
    """Return a folder for an evaluation that begins now: below ``--output_dir``, or ``outputs`` if
    that is not given.

    The file that ``--config_path`` names may give it, too. A training evaluates several times, so
    each evaluation has a folder of its own.
    """
    config = Path(parser.parse_arg("config_path") or "")
    told = read_yaml(config) if config.is_file() else {}
    folder = Path(parser.parse_arg("output_dir") or told.get("output_dir") or "outputs")
    return folder / "dynahoi" / datetime.now().strftime("%Y-%m-%d_%H-%M-%S_%f")


def queued_policy(n_action_steps: int) -> QueuedPolicy:
    """Return how the policy of LeRobot's command line answers calls for one action.

    Args:
        n_action_steps: how many calls an inference answers, where no command line names the policy;
            0 if not told.

    Raises:
        ValueError: if neither says how many, or if the two differ.
    """
    config = _policy_config()
    name, steps = (
        getattr(config, "type", "policy"),
        getattr(config, "n_action_steps", 0) or n_action_steps,
    )
    if n_action_steps not in (0, steps):
        raise ValueError(
            f"env.n_action_steps is {n_action_steps}, but the policy's is {steps}; leave it out"
        )
    if steps < 1:
        raise ValueError(
            f"inference async must know how many actions of a chunk {name!r} executes, and is "
            f"not told; pass "
            "--env.n_action_steps, or use dynahoi evaluate --inference async"
        )
    frames = (
        getattr(config, "lookback", None)
        or getattr(config, "observation_delta_indices", None)
        or [0]
    )
    return QueuedPolicy(name, steps, lookback_frames=-min(frames))


def _policy_config() -> Any | None:
    """The config that LeRobot reads from the command line, None if that names no policy."""
    overrides = [*parser.get_yaml_overrides("policy"), *(parser.get_cli_overrides("policy") or [])]
    if path := parser.get_path_arg("policy"):
        return PreTrainedConfig.from_pretrained(path, cli_overrides=overrides)
    if kind := parser.get_type_arg("policy"):
        return draccus.parse(PreTrainedConfig.get_choice_class(kind), args=overrides)
    return None
