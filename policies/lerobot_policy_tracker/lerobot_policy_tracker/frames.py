"""Encoded frames: each is encoded once and shared by all decisions that attend to it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

TENSORS = ("tokens", "proprioception", "position", "keep", "watching", "sightings")


@dataclass(frozen=True)
class EncodedFrames:
    """``T`` encoded frames of ``B`` samples, oldest first.

    Attributes:
        tokens: tokens of every image and of proprioception, shape ``(B, T, N, D)``.
        proprioception: all vector observations concatenated, normalised, shape ``(B, T, S)``.
        position: ``observation.state``, normalised, the reference of relative actions, shape ``(B, T, P)``; P may be 0.
        keep: False where a frame is padding, shape ``(B, T)``.
        watching: True where a frame is part of the observation window, shape ``(B, T)``.
        sightings: where the target was seen by each of C' eyes, see `sightings.py`, shape ``(B, T, C', N_SIGHTING)``.
        texts: one instruction per sample.
    """

    tokens: Tensor
    proprioception: Tensor
    position: Tensor
    keep: Tensor
    watching: Tensor
    sightings: Tensor
    texts: list[str]

    @classmethod
    def concatenate(cls, frames: list[EncodedFrames]) -> EncodedFrames:
        """Concatenate frames of the same samples along time; the instructions are those of the newest."""
        joined = {name: torch.cat([getattr(frame, name) for frame in frames], dim=1) for name in TENSORS}
        return cls(**joined, texts=frames[-1].texts)

    def rows(self, index: list[int]) -> EncodedFrames:
        """Return the samples at ``index``."""
        chosen = {name: getattr(self, name)[index] for name in TENSORS}
        return EncodedFrames(**chosen, texts=[self.texts[i] for i in index])

    def padding(self) -> EncodedFrames:
        """Return a fully masked copy."""
        return replace(self, keep=torch.zeros_like(self.keep))
