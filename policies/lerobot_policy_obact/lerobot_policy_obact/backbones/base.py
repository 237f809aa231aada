"""The interface of image encoders."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import torch
from torch import Tensor, nn

from ..registry import Registry

backbones: Registry[type[Backbone]] = Registry("backbone")

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


class Backbone(nn.Module, ABC):
    """Encodes frames independently into tokens.

    A subclass takes ``width`` first and its own options as keywords, and implements `forward`. One that ``locates`` the
    target begins its looks with a sighting, see `track.py`.

    Args:
        width: token size ``D`` it must return.
        mean: channel means its weights were trained with, for images in [0, 1].
        std: channel standard deviations.
        camera_pos_m: the camera's position relative to the palm [m], of one that locates.
    """

    reads_text: ClassVar[bool] = False
    locates: ClassVar[bool] = False
    sees_motion: ClassVar[bool] = False
    camera_pos: Tensor
    pixel_mean: Tensor
    pixel_std: Tensor

    def __init__(
        self,
        width: int,
        mean: tuple[float, ...] = IMAGENET_MEAN,
        std: tuple[float, ...] = IMAGENET_STD,
        camera_pos_m: tuple[float, ...] = (0.0, 0.0, 0.0),
    ) -> None:
        super().__init__()
        self.width = width
        self.register_buffer("pixel_mean", torch.tensor(mean).view(-1, 1, 1), persistent=False)
        self.register_buffer("camera_pos", torch.tensor(camera_pos_m), persistent=False)
        self.register_buffer("pixel_std", torch.tensor(std).view(-1, 1, 1), persistent=False)

    def standardise(self, images: Tensor) -> Tensor:
        """Map images in [0, 1], shape ``(F, C, H, W)``, to the range the weights expect."""
        return (images - self.pixel_mean) / self.pixel_std

    def load_pretrained(self) -> None:
        """Load published weights, if there are any; called when training starts, not when a checkpoint is opened."""

    def look(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """Do the part of `forward` that may be done once for all updates, if it is not trained; by default all."""
        return self(images, texts)

    def tokens(self, looks: Tensor) -> Tensor:
        """Do the rest, from looks ``(F, ...)`` to tokens ``(F, N, D)``."""
        return looks

    @abstractmethod
    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """Encode frames.

        Args:
            images: RGB in [0, 1], shape ``(F, 3, H, W)`` with ``F`` frames of any time and camera.
            texts: one instruction per frame, for backbones with ``reads_text``.

        Returns:
            Tokens, shape ``(F, N, D)``.
        """
