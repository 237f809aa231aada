"""ResNet-18 (He et al., 2016) from torchvision, with keypoint and grid tokens on top."""

from __future__ import annotations

from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchvision.models import ResNet, get_model, get_model_weights
from torchvision.ops import FrozenBatchNorm2d

from .base import Backbone, backbones
from .keypoints import KeypointTokens


@backbones.register("resnet18")
class ResNet18Backbone(Backbone):
    """Keypoint and grid tokens of ResNet features at 1/16 resolution.

    Args:
        width: token size.
        weights: name of torchvision's weights to start from; "" starts from random weights.
        n_keypoints: spatial-softmax tokens.
        grid: side of the grid of pooled tokens.
    """

    def __init__(self, width: int, *, weights: str = "IMAGENET1K_V1", n_keypoints: int = 16, grid: int = 2) -> None:
        super().__init__(width)
        self.weights, self.grid = weights, grid
        # Batch statistics over few, correlated frames are unreliable: use ImageNet's frozen ones, or group norm.
        norm = FrozenBatchNorm2d if weights else _group_norm
        self.resnet = cast(ResNet, get_model("resnet18", weights=None, norm_layer=norm))
        del self.resnet.layer4, self.resnet.fc
        self.keypoints = KeypointTokens(256, n_keypoints, width)
        self.grid_token = nn.Linear(256, width)
        self.slot = nn.Parameter(0.02 * torch.randn(n_keypoints + grid * grid, width))

    def load_pretrained(self) -> None:
        """Load torchvision's weights."""
        if self.weights:
            state = get_model_weights("resnet18")[self.weights].get_state_dict(progress=False)
            self.resnet.load_state_dict(state, strict=False)

    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """See `Backbone.forward`; ``N = n_keypoints + grid ** 2``."""
        net = self.resnet
        x = net.maxpool(net.relu(net.bn1(net.conv1(self.standardise(images)))))  # (F, 64, H/4, W/4)
        x = net.layer3(net.layer2(net.layer1(x)))  # (F, 256, H/16, W/16)
        pooled = F.adaptive_avg_pool2d(x, self.grid).flatten(2).transpose(1, 2)  # (F, grid^2, 256)
        return torch.cat([self.keypoints(x), self.grid_token(pooled)], dim=1) + self.slot  # (F, N, D)


def _group_norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(channels // 16, channels)
