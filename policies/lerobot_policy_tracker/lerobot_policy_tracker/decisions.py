"""The decisions of a batch: the window of frames of each, and which of them are computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from .configuration_tracker import TrackerConfig
from .frames import EncodedFrames


@dataclass(frozen=True)
class Decisions:
    """``K`` decisions in each of ``B`` samples of ``T`` frames; ``R`` of the ``B * K`` are wanted, that is, computed.

    Skipping the decisions whose actions are all masked saves their share of the attention and of the head.

    Attributes:
        frame_index: frames in the window of each decision, its current one last, shape ``(K, W)``.
        age_s: age of those frames at the decision [s], shape ``(W,)``.
        keep: False where a frame of a window is padding, or is not remembered, shape ``(B, K, W)``.
        exists: False where a frame is padding, shape ``(B, T)``.
        rows: wanted decisions, ``b * K + k`` each, ascending, shape ``(R,)``.
    """

    frame_index: Tensor
    age_s: Tensor
    keep: Tensor
    exists: Tensor
    rows: Tensor

    @classmethod
    def among(
        cls,
        keep: Tensor,
        frame_index: Sequence[Sequence[int]] | Tensor,
        age_s: Tensor,
        wanted: Tensor | None = None,
        hidden: Tensor | None = None,
    ) -> Decisions:
        """Build the decisions over frames of which some are padding.

        Args:
            keep: False where a frame is padding, shape ``(B, T)``. A decision always sees its own frame.
            frame_index: see the attribute; negative where there is no frame.
            age_s: see the attribute.
            wanted: decisions to compute, shape ``(B, K)``; None wants all.
            hidden: frames that the decisions do not see although they exist, shape ``(B, K, W)``.
        """
        index = torch.as_tensor(frame_index, device=keep.device)
        window = keep[:, index.clamp_min(0)] & (index >= 0)  # (B, K, W)
        if hidden is not None:
            window = window & ~hidden
        index = index.clamp_min(0)
        window = torch.cat([window[..., :-1], torch.ones_like(window[..., -1:])], dim=-1)
        wanted = torch.ones_like(window[..., 0]) if wanted is None else wanted
        return cls(index, age_s, window, keep, wanted.flatten().nonzero()[:, 0])

    def current(self, frames: Tensor) -> Tensor:
        """Select the current frame of each wanted decision, ``(B, T, ...) -> (R, ...)``."""
        return self.pick(frames[:, self.frame_index[:, -1]])

    def pick(self, entries: Tensor) -> Tensor:
        """Select the entries of the wanted decisions, ``(B, K, ...) -> (R, ...)``."""
        return entries.flatten(0, 1)[self.rows]

    def windows(self, frames: Tensor) -> Tensor:
        """Select the window of each wanted decision, ``(B, T, ...) -> (R, W, ...)``."""
        return self.pick(frames[:, self.frame_index])

    def of_sample(self, samples: Tensor) -> Tensor:
        """Select the entry of the sample of each wanted decision, ``(B, ...) -> (R, ...)``."""
        return samples[self.rows // self.keep.shape[1]]

    def spread(self, picked: Tensor) -> Tensor:
        """Undo `pick`, with zeros at the other decisions, ``(R, ...) -> (B, K, ...)``."""
        n_samples, n_decisions = self.keep.shape[:2]
        entries = picked.new_zeros(n_samples * n_decisions, *picked.shape[1:]).index_copy(0, self.rows, picked)
        return entries.unflatten(0, (n_samples, n_decisions))


def window_decisions(
    frames: EncodedFrames,
    frame_index: Sequence[Sequence[int]] | Tensor,
    config: TrackerConfig,
    wanted: Tensor | None = None,
) -> Decisions:
    """Return the decisions whose windows are spaced as the config says.

    Args:
        frames: encoded frames, with their padding.
        frame_index: frames in the window of each decision, shape ``(K, W)``.
        config: for the offsets of a window [frames] and the frame rate [Hz].
        wanted: decisions to compute, shape ``(B, K)``; None wants all.
    """
    windows, device = config.windows, frames.keep.device
    age_s = -torch.tensor(windows.lookback, device=device) / config.fps  # (W,)
    index = torch.as_tensor(frame_index, device=device)
    seen_acting = torch.tensor(windows.seen_acting, device=device)
    hidden = ~(seen_acting | frames.watching[:, index.clamp_min(0)])  # (B, K, W)
    return Decisions.among(frames.keep, index, age_s, wanted, hidden)
