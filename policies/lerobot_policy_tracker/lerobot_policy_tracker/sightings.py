"""Where eyes saw the target, and how far to trust them, in a frame that does not move with the hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from .eye import N_SCALES
from .frames import EncodedFrames

LEAST_ERROR_M = 0.003


@dataclass(frozen=True)
class Sightings:
    """What was seen in ``n`` frames by ``C'`` eyes, oldest first.

    Attributes:
        points: in the frame of the state, shape ``(B, n, C', 3)`` [m].
        rays: from the camera to there, of the same shape.
        errors_m: expected across and along the rays, shape ``(B, n, C', 2)``; infinite for what was not seen.
    """

    points: Tensor
    rays: Tensor
    errors_m: Tensor

    @classmethod
    def of(cls, frames: EncodedFrames, cameras: Tensor) -> Self:
        """Read the sightings of frames, padding included.

        Args:
            frames: with sightings.
            cameras: where those of the sightings were [m], in the frame of the state, shape ``(B, n, C', 3)``.
        """
        points = frames.position[:, :, None, :3] + frames.sightings[..., :3]
        rays = points - cameras
        scales = frames.sightings[..., -N_SCALES:].clamp(-5.0, 5.0)
        return cls(points, rays, (rays.norm(dim=-1, keepdim=True) * scales.exp()).clamp_min(LEAST_ERROR_M))

    def map(self, change: Callable[[Tensor], Tensor]) -> Self:
        """Return the sightings with every tensor changed alike."""
        return type(self)(*(change(part) for part in vars(self).values()))

    def where(self, keep: Tensor) -> Self:
        """Return them with nothing seen where ``keep`` is False; it has the shape of the errors less their last."""
        return replace(self, errors_m=self.errors_m.masked_fill(~keep[..., None], torch.inf))
