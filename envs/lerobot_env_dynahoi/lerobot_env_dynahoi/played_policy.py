"""The policy that LeRobot's command line names: an env is made before it, and never meets it."""

from __future__ import annotations

from typing import Any

import draccus
from lerobot.configs import PreTrainedConfig, parser

from dynahoi_lerobot.rollout.stepwise_inference import QueuedPolicy


def queued_policy(n_action_steps: int) -> QueuedPolicy:
    """Return how the policy of LeRobot's command line answers calls for one action.

    Args:
        n_action_steps: how many calls an inference answers, where no command line names the policy; 0 if not told.

    Raises:
        ValueError: if neither says how many, if the two differ, or if the policy infers at other times as well.
    """
    config = _policy_config()
    if config is None:
        return QueuedPolicy("policy", _known_steps("the policy", n_action_steps))
    steps = getattr(config, "n_action_steps", 0) or n_action_steps
    if n_action_steps not in (0, steps):
        raise ValueError(f"env.n_action_steps is {n_action_steps}, but the policy's is {steps}; leave it out")
    if key := getattr(config, "replan_key", ""):
        raise ValueError(
            f"{config.type!r} infers anew when {key} rises, in the middle of its queue; pass --policy.replan_key=''"
        )
    oldest = min(config.observation_delta_indices or [0])
    skipped = getattr(config, "latency_frames", 0)
    return QueuedPolicy(config.type, _known_steps(config.type, steps), skipped, lookback_frames=-oldest)


def _known_steps(name: str, n_action_steps: int) -> int:
    if n_action_steps < 1:
        raise ValueError(
            f"inference async must know how many actions of a chunk {name} executes, and is not told; pass "
            "--env.n_action_steps, or use dynahoi evaluate --inference async"
        )
    return n_action_steps


def _policy_config() -> Any | None:
    """The config that LeRobot reads from the command line, None if that names no policy."""
    overrides = [*parser.get_yaml_overrides("policy"), *(parser.get_cli_overrides("policy") or [])]
    if path := parser.get_path_arg("policy"):
        return PreTrainedConfig.from_pretrained(path, cli_overrides=overrides)
    if kind := parser.get_type_arg("policy"):
        return draccus.parse(PreTrainedConfig.get_choice_class(kind), args=overrides)
    return None
