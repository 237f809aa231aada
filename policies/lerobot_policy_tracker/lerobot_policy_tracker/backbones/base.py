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
    target implements `sightings` and `cameras`, too. ``n_cameras`` is how many it must have, None for any number.

    Args:
        width: token size ``D`` it must return.
        mean: channel means its weights were trained with, for images in [0, 1].
        std: channel standard deviations.
    """

    reads_text: ClassVar[bool] = False
    locates: ClassVar[bool] = False
    sees_motion: ClassVar[bool] = False
    n_cameras: ClassVar[int | None] = None
    pixel_mean: Tensor
    pixel_std: Tensor

    def __init__(
        self,
        width: int,
        mean: tuple[float, ...] = IMAGENET_MEAN,
        std: tuple[float, ...] = IMAGENET_STD,
    ) -> None:
        super().__init__()
        self.width = width
        self.register_buffer("pixel_mean", torch.tensor(mean).view(-1, 1, 1), persistent=False)
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

    def sightings(self, looks: Tensor, palm: Tensor) -> Tensor:
        """Return where the target was seen, ``(B, T, C', N_SIGHTING)``, see `sightings.py`.

        Args:
            looks: at the images of each frame, shape ``(B, T, C, L)``.
            palm: where it was [m], in the frame of the state, shape ``(B, T, 3)``.
        """
        raise NotImplementedError

    def cameras(self, palm: Tensor) -> Tensor:
        """Return where the cameras of those sightings were [m], in the frame of the state, ``(B, T, C', 3)``."""
        raise NotImplementedError

    @abstractmethod
    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """Encode frames.

        Args:
            images: RGB in [0, 1], shape ``(F, 3, H, W)``: all times, and of each the images of all cameras in turn.
            texts: one instruction per frame, for backbones with ``reads_text``.

        Returns:
            Tokens, shape ``(F, N, D)``.
        """
