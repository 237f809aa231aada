"""Pre- and postprocessing: LeRobot's defaults, which map the 1st and 99th percentile of actions to
-1 and 1.
"""

from typing import Any

import torch
from lerobot.processor.factory import make_default_pre_post_processors
from lerobot.utils.constants import ACTION
from transformers import AutoConfig

from .configuration_actiontokens import ActionTokensConfig


def make_actiontokens_pre_post_processors(
    config: ActionTokensConfig, dataset_stats: dict[str, dict[str, torch.Tensor]] | None = None
) -> tuple[Any, Any]:
    """Return the pipelines LeRobot runs before and after the policy.

    Args:
        config: the policy's config.
        dataset_stats: LeRobot statistics of the training data by feature key.

    Raises:
        ValueError: if ``config.unnorm_key`` is not in the checkpoint.
    """
    if config.unnorm_key is not None:
        dataset_stats = (dataset_stats or {}) | {
            ACTION: action_stats(config.vlm_name, config.unnorm_key)
        }
    return make_default_pre_post_processors(config, dataset_stats)


def action_stats(vlm_name: str, key: str) -> dict[str, torch.Tensor]:
    """Return the percentiles by which an OpenVLA checkpoint normalized the actions of the dataset
    ``key``.

    Dimensions that its mask excludes were not normalized: their percentiles are -1 and 1.

    Args:
        vlm_name: folder or Hub name of the checkpoint.
        key: dataset in its ``norm_stats``.

    Returns:
        ``q01`` and ``q99``, shape ``(A,)``, float32, in the unit of the action.

    Raises:
        ValueError: if there is no such dataset; the message lists the known ones.
    """
    known = getattr(AutoConfig.from_pretrained(vlm_name), "norm_stats", None) or {}
    if key not in known:
        raise ValueError(
            f"unnorm_key is {key!r}, but {vlm_name} has "
            f"{', '.join(sorted(known)) or 'no norm_stats'}."
        )
    stats = known[key]["action"]
    low, high = (torch.tensor(stats[name], dtype=torch.float32) for name in ("q01", "q99"))
    normalized = torch.tensor(stats.get("mask", [True] * len(low)))
    return {"q01": torch.where(normalized, low, -1.0), "q99": torch.where(normalized, high, 1.0)}
