"""The default encoder: a small convolutional network, trained from scratch on two CPU cores.

Catching needs to know *where* things are more than what they are. Spatial softmax (Levine et al., 2016) turns
a feature map into expected image positions with sub-pixel resolution and few parameters; here each map also
gathers the features under it, so that a token says both where and what. A coarse grid of pooled features adds
the rest of the scene.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..attention import sinusoidal_features
from .base import Backbone, backbones

N_COORDINATE_FEATURES = 12


def pixel_grid(height: int, width: int, device: torch.device) -> Tensor:
    """Return cell centres as (x, y) in [-1, 1], shape ``(height * width, 2)``."""
    y = (torch.arange(height, device=device) + 0.5) / height * 2 - 1
    x = (torch.arange(width, device=device) + 0.5) / width * 2 - 1
    rows, columns = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([columns, rows], dim=-1).flatten(0, 1)


@backbones.register("conv")
class ConvBackbone(Backbone):
    """Keypoint tokens and pooled grid tokens.

    Args:
        width: Token size.
        n_keypoints: Spatial-softmax tokens.
        grid: Side of the grid of pooled tokens.
        channels: Channels at 1/4 resolution; twice as many at 1/8.
    """

    def __init__(self, width: int, n_keypoints: int = 16, grid: int = 2, channels: int = 32) -> None:
        super().__init__(width, mean=(0.5, 0.5, 0.5), std=(0.25, 0.25, 0.25))
        self.grid = grid
        # Folding 4 x 4 pixels into channels costs a tenth of two strided convolutions at full resolution on a
        # CPU.
        self.stem = nn.Sequential(nn.PixelUnshuffle(4), _conv(48, channels), _conv(channels, channels))
        self.deep = nn.Sequential(_conv(channels, 2 * channels, stride=2), _conv(2 * channels, 2 * channels))
        self.lateral = nn.Conv2d(2 * channels, channels, kernel_size=1)
        self.heatmaps = nn.Conv2d(channels, n_keypoints, kernel_size=1)
        self.keypoint_token = nn.Linear(channels + 2 + 2 * N_COORDINATE_FEATURES, width)
        self.grid_token = nn.Linear(2 * channels, width)
        self.slot = nn.Parameter(0.02 * torch.randn(n_keypoints + grid * grid, width))

    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """See `Backbone.forward`; ``N = n_keypoints + grid ** 2``."""
        fine = self.stem(_pad_to_multiple(self.standardise(images), 8))  # (F, C, H/4, W/4)
        coarse = self.deep(fine)  # (F, 2C, H/8, W/8)
        features = fine + F.interpolate(self.lateral(coarse), scale_factor=2.0)  # (F, C, H/4, W/4)
        pooled = F.adaptive_avg_pool2d(coarse, self.grid).flatten(2).transpose(1, 2)  # (F, grid^2, 2C)
        tokens = torch.cat([self.keypoint_token(self.keypoints(features)), self.grid_token(pooled)], dim=1)
        return tokens + self.slot  # (F, N, D)

    def keypoints(self, features: Tensor) -> Tensor:
        """Return where each heat map points and what lies there, ``(F, C, h, w) -> (F, K, C + 2 +
        waves)``.
        """
        grid = pixel_grid(*features.shape[-2:], features.device)
        weights = self.heatmaps(features).flatten(2).softmax(-1)  # (F, K, h*w)
        what = weights @ features.flatten(2).transpose(1, 2)  # (F, K, C)
        where = weights @ grid.to(weights.dtype)  # (F, K, 2)
        waves = sinusoidal_features(where, N_COORDINATE_FEATURES, 0.125, 4.0).flatten(-2).to(weights.dtype)
        return torch.cat([what, where, waves], dim=-1)


def _conv(n_in: int, n_out: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(n_in, n_out, kernel_size=3, stride=stride, padding=1, bias=False),
        nn.GroupNorm(n_out // 8, n_out),
        nn.SiLU(inplace=True),
    )


def _pad_to_multiple(images: Tensor, multiple: int) -> Tensor:
    height, width = images.shape[-2:]
    pad = (-width % multiple, -height % multiple)
    return F.pad(images, (0, pad[0], 0, pad[1])) if any(pad) else images
