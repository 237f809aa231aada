"""Pre- and postprocessing: LeRobot's default pipelines."""

from __future__ import annotations

from typing import Any

import torch
from lerobot.lerobot_types import PolicyAction
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.factory import make_default_pre_post_processors

from .configuration_tracker import TrackerConfig


def make_tracker_pre_post_processors(
    config: TrackerConfig, dataset_stats: dict[str, dict[str, torch.Tensor]] | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[PolicyAction, PolicyAction],
]:
    """Return the pipelines LeRobot runs before and after the policy.

    They are LeRobot's defaults, so every override of `lerobot-train` and `lerobot-eval` works; image resizing and
    relative actions are part of the policy.

    Args:
        config: the policy's config.
        dataset_stats: LeRobot statistics of the training data by feature key.
    """
    return make_default_pre_post_processors(config, dataset_stats)
