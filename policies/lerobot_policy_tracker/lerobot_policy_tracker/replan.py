"""The replan indicator: an observation whose last entry is 0 while the hand is held still and 1 once it may move.

Its rise drops the rest of the current chunk, so that chunks predicted before the rise are never executed, and nothing
is learned from them. LeRobot normalises the indicator like any other observation; `rise_threshold` is the value, in
whatever units that gives, that separates before from after.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from lerobot.configs import NormalizationMode
from torch import Tensor

from .action_frame import affine_of
from .configuration_tracker import TrackerConfig

EPS = 1e-8  # by which LeRobot divides where a feature does not vary


def indicator(batch: Mapping[str, Any], config: TrackerConfig, *shape: int) -> Tensor | None:
    """Return the last entry of ``config.replan_key``, normalised, of shape ``shape``; None in batches without it."""
    value = batch.get(config.replan_key)
    return None if value is None else value.reshape(*shape, -1)[..., -1]


def rise_threshold(config: TrackerConfig, stats: dict[str, dict[str, Any]] | None) -> float:
    """Return the normalised value of ``config.replan_key`` from which on it has risen.

    Args:
        config: the policy's config.
        stats: LeRobot statistics that the batches are normalised with. Without them the indicator is taken to be 0
            before and 1 after its rise, and to vary within the normalised range.

    Returns:
        The image of the middle between the indicator's extremes; minus infinity if it never changes, as in data
        without an observation window.
    """
    mode = _mode(config)
    stat = (stats or {}).get(config.replan_key)
    if stat is None:
        return 0.5 if mode is NormalizationMode.IDENTITY else 0.0
    low, high = (torch.as_tensor(stat[name], dtype=torch.float32).flatten()[-1] for name in ("min", "max"))
    if low == high:
        return -torch.inf
    scale, shift = affine_of(stat, mode) or (torch.ones(1), torch.zeros(1))
    return float(((low + high) / 2 - shift[-1]) / scale[-1].clamp_min(EPS))


def risen(config: TrackerConfig) -> Tensor:
    """Return ``config.replan_key`` after its rise, ``(D,)``: all 0 but the last; its mean, 0, if it is normalised."""
    size = (config.input_features or {})[config.replan_key].shape[0]
    value = torch.zeros(size)
    if _mode(config) is NormalizationMode.IDENTITY:
        value[-1] = 1.0
    return value


def _mode(config: TrackerConfig) -> NormalizationMode:
    """Return how LeRobot normalises the indicator; what is no input of the policy it leaves as it is."""
    feature = (config.input_features or {}).get(config.replan_key)
    if feature is None:
        return NormalizationMode.IDENTITY
    return config.normalization_mapping.get(feature.type.value, NormalizationMode.IDENTITY)
