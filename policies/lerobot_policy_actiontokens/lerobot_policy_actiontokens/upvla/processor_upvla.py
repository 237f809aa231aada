"""Pre- and postprocessing: LeRobot's defaults, which map the 1st and 99th percentile of actions to -1 and 1."""

from __future__ import annotations

from typing import Any

import torch
from lerobot.processor.factory import make_default_pre_post_processors

from .configuration_upvla import UPVLAConfig


def make_upvla_pre_post_processors(
    config: UPVLAConfig, dataset_stats: dict[str, dict[str, torch.Tensor]] | None = None
) -> tuple[Any, Any]:
    """Return the pipelines LeRobot runs before and after the policy.

    Args:
        config: the policy's config.
        dataset_stats: LeRobot statistics of the training data by feature key.
    """
    return make_default_pre_post_processors(config, dataset_stats)
