"""Supervision by what only the simulator knows: where the target is.

A chunk of actions says little about what was seen: a few centimetres of motion for thousands of pixels. Telling the
network during training where the target is in every frame teaches its eyes directly; telling it where the target will
be teaches its attention over time what a window of frames is good for. Acting needs none of it.

LeRobot's preprocessing passes observations and actions only, and privileged columns must not become observations. But
every batch names its frames by their ``index``, so the column is read from the dataset's own files once, and looked up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from torch import Tensor, nn

from .action_frame import ActionFrame
from .windows import DecisionWindows


class FrameColumn:
    """One vector column of a LeRobot dataset, by global frame index.

    Args:
        meta: The dataset's LeRobot metadata.
        key: Name of the column.
        n_dims: Leading entries to keep.

    Raises:
        ValueError: If the dataset has no such column of at least that many entries.
    """

    def __init__(self, meta: Any, key: str, n_dims: int) -> None:
        feature = meta.features.get(key)
        if feature is None or len(feature["shape"]) != 1 or feature["shape"][0] < n_dims:
            raise ValueError(
                f"privileged_key is {key!r}, but must name a vector column of {n_dims} or more entries; the dataset "
                f"has {', '.join(meta.features)}."
            )
        files = sorted(Path(meta.root).glob("data/*/*.parquet"))
        tables = [pq.read_table(file, columns=["index", key]) for file in files]
        index = np.concatenate([table["index"].to_numpy() for table in tables])
        values = np.concatenate([_as_array(table[key])[:, :n_dims] for table in tables])
        self.values = torch.from_numpy(values[np.argsort(index)])  # (F, n_dims), physical units

    def __call__(self, index: Tensor, offsets: list[int]) -> Tensor:
        """Return the column at ``index + offsets``, shape ``(B, T, n_dims)``.

        Args:
            index: Global index of each sample's own frame, shape ``(B,)``.
            offsets: Frames relative to it. Those outside the sample's episode return something: mask them.
        """
        frames = index.cpu().reshape(-1, 1) + torch.tensor(offsets)  # (B, T)
        return self.values[frames.clamp(0, len(self.values) - 1)].to(index.device)


class Supervision:
    """What the network is told in training, in units of the normalised state, relative to where the hand is.

    Args:
        column: Where the target is in every frame.
        frame: The coordinates of actions and state.
        windows: The frames of a training sample.
        foresight: How far ahead of each decision the target's place is asked for [frames]; may be empty.
    """

    def __init__(self, column: FrameColumn, frame: ActionFrame, windows: DecisionWindows, foresight: list[int]) -> None:
        self.column, self.frame, self.windows, self.foresight = column, frame, windows, foresight

    def seen(self, probe: PositionProbe, index: Tensor, position: Tensor, tokens: Tensor) -> Tensor:
        """Return how far off the probe is in every frame, ``(B, T)``.

        Args:
            probe: Reads the place off the tokens of a frame.
            index: Global index of each sample's own frame, shape ``(B,)``.
            position: Where the hand is, normalised, shape ``(B, T, P)``.
            tokens: Of every frame, shape ``(B, T, N, D)``.
        """
        return (probe(tokens) - self._offsets(index, self.windows.observation_offsets, position)).abs().mean(-1)

    def foreseen(self, probe: PositionProbe, index: Tensor, position: Tensor, fused: Tensor) -> Tensor:
        """Return how far off the probe is about what comes after every decision, ``(B * K, F)``.

        Args:
            probe: Reads ``F`` places off the tokens of a decision.
            index: Global index of each sample's own frame, shape ``(B,)``.
            position: Where the hand is at the decision, normalised, shape ``(B * K, P)``.
            fused: Tokens of every decision, aware of its window, shape ``(B * K, N, D)``.
        """
        ahead = [moment + frames for moment in self.windows.decision_moments for frames in self.foresight]
        here = position.unflatten(0, (len(index), -1)).repeat_interleave(len(self.foresight), dim=1)  # (B, K*F, P)
        places = self._offsets(index, ahead, here)  # (B, K*F, P)
        told = probe(fused).unflatten(-1, (len(self.foresight), -1))  # (B*K, F, P)
        return (told - places.reshape(told.shape)).abs().mean(-1)

    def _offsets(self, index: Tensor, frames: list[int], position: Tensor) -> Tensor:
        place = self.frame.normalise_state(self.column(index, frames))  # (B, T, P)
        return place - position[..., : place.shape[-1]]


class PositionProbe(nn.Module):
    """Reads one or several positions off tokens.

    Args:
        width: Token size.
        n_dims: Size of the position, or of all of them together.
    """

    def __init__(self, width: int, n_dims: int) -> None:
        super().__init__()
        self.relevance = nn.Linear(width, 1)
        self.position = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, n_dims))

    def forward(self, tokens: Tensor) -> Tensor:
        """Map tokens ``(..., N, D)`` to positions ``(..., n_dims)``."""
        weights = self.relevance(tokens).softmax(dim=-2)  # (..., N, 1)
        return self.position((weights * tokens).sum(dim=-2))


def _as_array(column: Any) -> np.ndarray:
    values = column.combine_chunks()
    return values.flatten().to_numpy(zero_copy_only=False).reshape(len(values), -1).astype(np.float32)
