"""The decisions of a batch: what each of them may look at, and which of them are worth computing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from .configuration_obact import ObActConfig
from .frames import EncodedFrames


@dataclass(frozen=True)
class Decisions:
    """``K`` decisions in each of ``B`` samples of ``T`` frames; ``R`` of them are wanted.

    A decision none of whose actions is learned from costs as much as any other, so it is left out from the start.

    Attributes:
        frame_index: Frames in the window of each decision, without repeats, its current one last, shape ``(K, W)``.
        age_s: Time of those frames before their decision [s], shape ``(W,)``.
        keep: False where a frame of a window is padding, shape ``(B, K, W)``.
        rows: Wanted decisions, ``b * K + k`` each, ascending, shape ``(R,)``.
    """

    frame_index: Tensor
    age_s: Tensor
    keep: Tensor
    rows: Tensor

    @classmethod
    def among(
        cls, keep: Tensor, frame_index: Sequence[Sequence[int]], age_s: Tensor, wanted: Tensor | None = None
    ) -> Decisions:
        """Return the decisions over frames of which some are padding.

        Args:
            keep: False where a frame is padding, shape ``(B, T)``. A decision always sees its own frame.
            frame_index: See the attribute.
            age_s: See the attribute.
            wanted: Decisions to compute, shape ``(B, K)``; None wants all.
        """
        index = torch.tensor(frame_index, device=keep.device)
        window = keep[:, index]  # (B, K, W)
        window = torch.cat([window[..., :-1], torch.ones_like(window[..., -1:])], dim=-1)
        wanted = torch.ones_like(window[..., 0]) if wanted is None else wanted
        return cls(index, age_s, window, wanted.flatten().nonzero()[:, 0])

    def current(self, frames: Tensor) -> Tensor:
        """Pick the current frame of each wanted decision, ``(B, T, ...) -> (R, ...)``."""
        return self.pick(frames[:, self.frame_index[:, -1]])

    def pick(self, places: Tensor) -> Tensor:
        """Pick what belongs to each wanted decision, ``(B, K, ...) -> (R, ...)``."""
        return places.flatten(0, 1)[self.rows]

    def of_sample(self, samples: Tensor) -> Tensor:
        """Pick what belongs to the sample of each wanted decision, ``(B, ...) -> (R, ...)``."""
        return samples[self.rows // self.keep.shape[1]]

    def spread(self, picked: Tensor) -> Tensor:
        """Undo `pick`, with zeros at the other decisions, ``(R, ...) -> (B, K, ...)``."""
        n_samples, n_decisions = self.keep.shape[:2]
        places = picked.new_zeros(n_samples * n_decisions, *picked.shape[1:]).index_copy(0, self.rows, picked)
        return places.unflatten(0, (n_samples, n_decisions))


def window_decisions(
    frames: EncodedFrames,
    frame_index: Sequence[Sequence[int]],
    config: ObActConfig,
    wanted: Tensor | None = None,
) -> Decisions:
    """Return the decisions whose windows are spaced as the config says.

    Args:
        frames: Encoded frames, with their padding.
        frame_index: Frames in the window of each decision, shape ``(K, s + 1)``.
        config: For the offsets of a window [frames] and the frame rate [Hz].
        wanted: Decisions to compute, shape ``(B, K)``; None wants all.
    """
    age_s = -torch.tensor(config.windows.lookback, device=frames.keep.device) / config.fps  # (s + 1,)
    return Decisions.among(frames.keep, frame_index, age_s, wanted)
