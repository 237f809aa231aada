"""Image augmentation with the same random parameters for all frames of a sample, which preserves apparent motion."""

from __future__ import annotations

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from .configuration_tracker import TrackerConfig
from .observation import Observation


def augmented(observation: Observation, config: TrackerConfig) -> Observation:
    """Return the observation with randomly shifted and colour-jittered images, as the config says."""
    shape = observation.images.shape
    images = observation.images.flatten(1, 2)  # (B, T, C, 3, H, W) -> (B, T*C, 3, H, W): one draw per sample
    images = jitter_colors(shift_images(images, config.random_shift_px), config.color_jitter)
    return replace(observation, images=images.reshape(shape))


def shift_images(images: Tensor, max_shift_px: int) -> Tensor:
    """Shift each sample by a random whole number of pixels, replicating the border.

    Args:
        images: shape ``(B, T, 3, H, W)``.
        max_shift_px: largest shift along each axis [px].
    """
    if max_shift_px == 0:
        return images
    height, width = images.shape[-2:]
    padded = F.pad(images.flatten(0, 1), [max_shift_px] * 4, mode="replicate").unflatten(0, images.shape[:2])
    corners = torch.randint(0, 2 * max_shift_px + 1, (len(images), 2)).tolist()
    crops = [sample[..., y : y + height, x : x + width] for sample, (y, x) in zip(padded, corners, strict=True)]
    return torch.stack(crops)


def jitter_colors(images: Tensor, max_change: float) -> Tensor:
    """Scale the contrast and brightness of each sample by a random factor.

    Args:
        images: in [0, 1], shape ``(B, T, 3, H, W)``.
        max_change: largest relative change: factors are within ``1 +- max_change``.
    """
    if max_change == 0:
        return images
    shape = (len(images), 1, 1, 1, 1)
    contrast, brightness = (1 + max_change * (2 * torch.rand(2, *shape, device=images.device) - 1)).unbind(0)
    mean = images.mean(dim=(1, 2, 3, 4), keepdim=True)
    return ((images - mean) * contrast + mean * brightness).clamp(0, 1)
