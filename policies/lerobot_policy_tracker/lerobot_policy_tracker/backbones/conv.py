"""The default encoder: a small convolutional network, trained from scratch on two CPU cores."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..eye import StandardisedPatches, conv, saturation
from .base import Backbone, backbones
from .keypoints import KeypointTokens


@backbones.register("conv")
class ConvBackbone(Backbone):
    """Spatial-softmax keypoint tokens for moving objects, and a coarse grid of average-pooled tokens for the scene.

    Args:
        width: token size.
        n_keypoints: spatial-softmax tokens.
        grid: side of the grid of pooled tokens.
        channels: channels at 1/4 resolution, a multiple of 8; twice as many at 1/8.
        saturation: add the colour saturation of each pixel as a fourth input channel. Objects are more saturated than
            walls and floors, and a linear first layer cannot compute saturation.
    """

    def __init__(
        self, width: int, *, n_keypoints: int = 16, grid: int = 2, channels: int = 32, saturation: bool = True
    ) -> None:
        mean = (0.5, 0.5, 0.5, 0.25) if saturation else (0.5, 0.5, 0.5)
        super().__init__(width, mean, std=(0.25,) * len(mean))
        self.grid, self.saturation = grid, saturation
        self.stem = nn.Sequential(StandardisedPatches(len(mean), channels), conv(channels, channels))
        self.deep = nn.Sequential(conv(channels, 2 * channels, stride=2), conv(2 * channels, 2 * channels))
        self.lateral = nn.Conv2d(2 * channels, channels, kernel_size=1)
        self.keypoints = KeypointTokens(channels, n_keypoints, width)
        self.grid_token = nn.Linear(2 * channels, width)
        self.slot = nn.Parameter(0.02 * torch.randn(n_keypoints + grid * grid, width))

    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """See `Backbone.forward`; ``N = n_keypoints + grid ** 2``."""
        if self.saturation:
            images = torch.cat([images, saturation(images)], dim=1)
        # Channels last makes convolutions on a CPU a third faster and their maps token-shaped without a copy.
        pixels = _pad_to_multiple(images, 8).contiguous(memory_format=torch.channels_last)
        patches, refine = self.stem
        fine = refine(patches(pixels, self.pixel_mean, self.pixel_std))  # (F, C, H/4, W/4)
        coarse = self.deep(fine)  # (F, 2C, H/8, W/8)
        features = fine + F.interpolate(self.lateral(coarse), scale_factor=2.0)  # (F, C, H/4, W/4)
        pooled = F.adaptive_avg_pool2d(coarse, self.grid).flatten(2).transpose(1, 2)  # (F, grid^2, 2C)
        return torch.cat([self.keypoints(features), self.grid_token(pooled)], dim=1) + self.slot  # (F, N, D)


def _pad_to_multiple(images: Tensor, multiple: int) -> Tensor:
    height, width = images.shape[-2:]
    bottom, right = -height % multiple, -width % multiple
    return F.pad(images, (0, right, 0, bottom)) if bottom or right else images
