"""Pre- and postprocessing: LeRobot's default pipelines."""

from typing import Any

import torch
from lerobot.lerobot_types import PolicyAction
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.factory import make_default_pre_post_processors

from .configuration_obact import ObActConfig


def make_obact_pre_post_processors(
    config: ObActConfig, dataset_stats: dict[str, dict[str, torch.Tensor]] | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[PolicyAction, PolicyAction],
]:
    """Return the pipelines that LeRobot runs before and after the policy: its defaults, so that every override works.

    Args:
        config: the policy's config; it asks for no normalisation, as the policy works in metres and radians.
        dataset_stats: LeRobot statistics of the training data by feature key.
    """
    return make_default_pre_post_processors(config, dataset_stats)
