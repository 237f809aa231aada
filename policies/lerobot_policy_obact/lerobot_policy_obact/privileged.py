"""Supervision by what only the simulator knows: where the target is.

A chunk of actions says little about what was seen: a few centimetres of motion for thousands of pixels. Telling the
network during training where the target is in every frame teaches its eyes directly. Acting needs none of it.

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

from .configuration_obact import ObActConfig


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


def privileged_labels(config: ObActConfig, meta: Any | None) -> FrameColumn | None:
    """Open the privileged column that the config names, if there is a dataset to train on.

    Args:
        config: The policy's config, its ``action_frame`` resolved.
        meta: The dataset's LeRobot metadata; None while acting.

    Raises:
        ValueError: If actions are not relative: the coordinates of ``observation.state`` are then unknown.
    """
    if not config.privileged_key or meta is None:
        return None
    if config.action_frame != "relative":
        raise ValueError(
            f"privileged_key is {config.privileged_key!r}, but only action_frame='relative' knows the coordinates of "
            f"'observation.state'; action_frame is {config.action_frame!r}, so privileged_key must be ''."
        )
    return FrameColumn(meta, config.privileged_key, config.relative_dims)


class PositionProbe(nn.Module):
    """Reads a position off the tokens of a single frame.

    Args:
        width: Token size.
        n_dims: Size of the position.
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
