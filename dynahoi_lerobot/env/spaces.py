"""The observation space, and observations as its members; both follow the feature table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from dynahoi_lerobot.agent import Observation
from dynahoi_lerobot.feature import Feature
from dynahoi_lerobot.features import FEATURES, PIXELS


def observation_space(features: Sequence[Feature]) -> spaces.Dict:
    """Return the space of one world's observations: a Box for each of ``features`` that policies see.

    Args:
        features: see ``features.frame_features``; those that policies do not see are left out.
    """
    groups: dict[str, dict[str, spaces.Space]] = {"": {}}
    for feature in features:
        if feature.observed and feature.gym_key is not None:
            group, _, key = feature.gym_key.rpartition("/")
            box = spaces.Box(feature.low, feature.high, feature.shape, np.dtype(feature.dtype).type)
            groups.setdefault(group, {})[key] = box
    ungrouped = groups.pop("")
    return spaces.Dict({**{group: spaces.Dict(boxes) for group, boxes in groups.items()}, **ungrouped})


def as_gym(observation: Observation) -> dict[str, Any]:
    """Return an Observation under the keys of ``observation_space``, (N, ...) each, clipped to its bounds."""
    entries: dict[str, Any] = {PIXELS: observation.images} if observation.images else {}
    for feature in FEATURES.values():
        if feature.observed and feature.gym_key is not None:
            value = getattr(observation, feature.name)
            if value is not None:
                entries[feature.gym_key] = np.clip(value, feature.low, feature.high)
    return entries
