"""Keypoint tokens by spatial softmax over a feature map."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..attention import sinusoidal_features
from ..eye import pixel_grid

N_FREQUENCIES = 12


class KeypointTokens(nn.Module):
    """Learned heat maps, each read as an expected image position and the features under it.

    For catching, positions matter more than appearance, and the spatial softmax (Levine et al., 2016) gives positions
    of sub-pixel resolution with few parameters.

    Args:
        channels: channels of the feature map.
        n_keypoints: number of heat maps.
        width: token size.
    """

    def __init__(self, channels: int, n_keypoints: int, width: int) -> None:
        super().__init__()
        self.heatmaps = nn.Conv2d(channels, n_keypoints, kernel_size=1)
        self.token = nn.Linear(channels + 2 + 2 * N_FREQUENCIES, width)

    def forward(self, features: Tensor) -> Tensor:
        """Map features ``(F, C, h, w)`` to tokens ``(F, K, D)``."""
        weights = self.heatmaps(features).flatten(2).softmax(-1)  # (F, K, h*w)
        pooled = weights @ features.flatten(2).transpose(1, 2)  # (F, K, C)
        position = weights @ pixel_grid(features.shape[-2], features.shape[-1], features.device).to(
            weights.dtype
        )  # (F, K, 2)
        sinusoids = sinusoidal_features(position, N_FREQUENCIES, min_period=0.125, max_period=4.0).flatten(
            -2
        )  # (F, K, 2*n)
        return self.token(torch.cat([pooled, position, sinusoids.to(pooled.dtype)], dim=-1))
