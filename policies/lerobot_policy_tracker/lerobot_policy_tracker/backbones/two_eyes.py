"""Two eyes: one for the hand's camera, one for the camera that stands still beside it.

One small picture tells the direction to the target and hardly its distance. Two lines of sight that cross tell both.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor, nn

from ..eye import UNSEEN_SCALE
from .base import Backbone, backbones
from .eye import EyeBackbone


@backbones.register("two_eyes")
class TwoEyes(Backbone):
    """An `EyeBackbone` for the images of each camera: first ``observation.images.ego``, then ``.side``.

    Args:
        width: token size.
        ego: options of the eye for the hand's camera.
        side: options of the other one.
    """

    locates = True
    sees_motion = True
    n_cameras = 2

    def __init__(self, width: int, *, ego: dict[str, Any] | None = None, side: dict[str, Any] | None = None) -> None:
        super().__init__(width)
        self.eyes = nn.ModuleList(
            [EyeBackbone(width, **(ego or {}), camera="ego"), EyeBackbone(width, **(side or {}), camera="side")]
        )

    @property
    def _pair(self) -> list[EyeBackbone]:
        return cast(list[EyeBackbone], list(self.eyes))

    def load_pretrained(self) -> None:
        """Load what the eyes have learned, where their options name a file."""
        for eye in self._pair:
            eye.load_pretrained()

    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """See `Backbone.forward`; one token."""
        return self.tokens(self.look(images))

    def look(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """Return what `EyeBackbone.look` returns, ``(F, 3, H, W) -> (F, L)``."""
        return _in_turn([eye.look for eye in self._pair], images)

    def tokens(self, looks: Tensor) -> Tensor:
        """Map looks ``(F, L)`` to tokens ``(F, 1, D)``."""
        return _in_turn([eye.tokens for eye in self._pair], looks)

    def sightings(self, looks: Tensor, palm: Tensor) -> Tensor:
        """See `Backbone.sightings`; the second line of sight is taken without its distance.

        Its errors of distance are as alike from frame to frame as those of the first; the factor that is fitted to
        them, see `fitting.py`, is one. Its errors across are in units of half its view, which is narrower.
        """
        first, second = (eye.sightings(looks[:, :, i : i + 1], palm) for i, eye in enumerate(self._pair))
        place, across, along = second.split([6, 1, 1], dim=-1)
        across = across + math.log(self._pair[1].camera.half_view)
        return torch.cat([first, torch.cat([place, across, torch.full_like(along, UNSEEN_SCALE)], dim=-1)], dim=2)

    def cameras(self, palm: Tensor) -> Tensor:
        """See `Backbone.cameras`."""
        return torch.cat([eye.cameras(palm) for eye in self._pair], dim=2)


def _in_turn(views: list[Callable[[Tensor], Tensor]], frames: Tensor) -> Tensor:
    """Map frames ``(F, ...)``, of all cameras in turn, each by the function of its camera."""
    parts = frames.unflatten(0, (-1, len(views))).unbind(1)
    return torch.stack([view(part) for view, part in zip(views, parts, strict=True)], dim=1).flatten(0, 1)
