"""Any vision tower of ``transformers`` (SigLIP, DINOv2, CLIP, ViT, ConvNeXt, ...), by hub name or folder."""

from __future__ import annotations

import math
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .base import Backbone, backbones


@backbones.register("transformers_vision")
class TransformersVisionBackbone(Backbone):
    """A pretrained tower whose patches are pooled to a small grid of tokens.

    Args:
        width: token size.
        name: Hub name or folder; its ``config.json`` is needed whenever the policy is opened, its weights only when
            training starts.
        pretrained: whether training starts from its weights.
        freeze: whether its weights are excluded from training.
        grid: side of the grid to which patches are pooled, to keep attention over many frames cheap.
    """

    def __init__(
        self,
        width: int,
        *,
        name: str = "facebook/dinov2-small",
        pretrained: bool = True,
        freeze: bool = True,
        grid: int = 4,
    ) -> None:
        from transformers import AutoConfig, AutoModel

        settings = _image_settings(name)
        super().__init__(width, settings["image_mean"], settings["image_std"])
        self.name, self.pretrained, self.freeze, self.grid = name, pretrained, freeze, grid
        config = AutoConfig.from_pretrained(name)
        self.tower = _vision_part(AutoModel.from_config(config))
        vision = getattr(config, "vision_config", config)
        self.input_px = getattr(vision, "image_size", None)
        self.project = nn.Linear(getattr(vision, "hidden_sizes", [vision.hidden_size])[-1], width)
        self.tower.requires_grad_(not freeze)

    def load_pretrained(self) -> None:
        """Load the tower's published weights."""
        from transformers import AutoModel

        if self.pretrained:
            self.tower.load_state_dict(_vision_part(AutoModel.from_pretrained(self.name)).state_dict())

    def train(self, mode: bool = True) -> TransformersVisionBackbone:
        """Keep a frozen tower in evaluation mode."""
        super().train(mode)
        if self.freeze:
            self.tower.eval()
        return self

    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """See `Backbone.forward`; ``N = grid ** 2`` and the tower's class tokens, if it has any."""
        if self.input_px:
            images = F.interpolate(images, (self.input_px,) * 2, mode="bilinear", align_corners=False)
        with torch.set_grad_enabled(torch.is_grad_enabled() and not self.freeze):
            features = self.tower(pixel_values=self.standardise(images)).last_hidden_state
        return self.project(pool_patches(features, self.grid))


def pool_patches(features: Tensor, grid: int) -> Tensor:
    """Average patch features to ``grid x grid`` tokens; tokens before the patches (class tokens) are kept.

    Args:
        features: tokens ``(F, P + n * n, C)`` or a map ``(F, C, h, w)``.
        grid: side of the result.

    Returns:
        Shape ``(F, P + grid * grid, C)``.
    """
    if features.dim() == 4:
        return F.adaptive_avg_pool2d(features, grid).flatten(2).transpose(1, 2)  # (F, C, h, w) -> (F, g*g, C)
    side = math.isqrt(features.shape[1])
    first, patches = features.split([features.shape[1] - side**2, side**2], dim=1)
    patches = patches.transpose(1, 2).unflatten(2, (side, side))  # (F, n*n, C) -> (F, C, n, n)
    return torch.cat([first, pool_patches(patches, grid)], dim=1)


def _vision_part(model: nn.Module) -> nn.Module:
    """Return the image side of a model that also reads text, or the model."""
    return getattr(model, "vision_model", model)


def _image_settings(name: str) -> dict[str, Any]:
    """Return the image processor settings of the tower, which hold the channel statistics it was trained with."""
    from transformers import ImageProcessingMixin

    settings, _ = ImageProcessingMixin.get_image_processor_dict(name)
    return settings
