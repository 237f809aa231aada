"""Auxiliary loss on the visual encoder: predict the target's position, which only the simulator knows.

Actions alone are a weak training signal for an image encoder. In training, a probe on the tokens of each frame also
predicts the position of the target, which is read from a privileged column of the dataset. Acting does not use it.

LeRobot's preprocessing keeps observations and actions only, and privileged columns must not become observations. As
every batch carries the ``index`` of its frames, the column is read once from the dataset's files and then looked up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from dynahoi_lerobot.dataset import frame_column

from .configuration_tracker import TrackerConfig


class FrameColumn:
    """One vector column of a LeRobot dataset, by global frame index, see ``dynahoi_lerobot.dataset.frame_column``.

    Args:
        meta: the dataset's LeRobot metadata.
        key: name of the column.
        n_dims: leading entries to keep.

    Raises:
        ValueError: if the dataset has no such column of at least that many entries.
    """

    def __init__(self, meta: Any, key: str, n_dims: int) -> None:
        self.values = torch.from_numpy(read_column(meta, key, n_dims)[:, :n_dims])  # in the unit of the column

    def __call__(self, index: Tensor, offsets: list[int]) -> Tensor:
        """Return the column at ``index + offsets``, shape ``(B, T, n_dims)``, in the unit of the column.

        Args:
            index: global index of each sample's own frame, shape ``(B,)``.
            offsets: frames relative to it. Values outside the sample's episode are arbitrary and must be masked.
        """
        frames = index.cpu().reshape(-1, 1) + torch.tensor(offsets)  # (B, T)
        return self.values[frames.clamp(0, len(self.values) - 1)].to(index.device)


def read_column(meta: Any, key: str, n_dims: int) -> np.ndarray:
    """Return a column of a LeRobot dataset in the order of its frames, float32, shape ``(F, D)``.

    Args:
        meta: the dataset's LeRobot metadata.
        key: name of the column.
        n_dims: entries it must have at least.

    Raises:
        ValueError: if the dataset has no such column of at least that many entries.
    """
    values = frame_column(Path(meta.root), key)
    if values.shape[1] < n_dims:
        raise ValueError(f"training needs {n_dims} or more entries of {key!r}; the dataset has {values.shape[1]}.")
    return values.astype(np.float32)


def privileged_labels(config: TrackerConfig, meta: Any | None) -> FrameColumn | None:
    """Open the privileged column that the config names, if there is a dataset to train on.

    Args:
        config: the policy's config, its ``action_frame`` resolved.
        meta: the dataset's LeRobot metadata; None while acting.

    Raises:
        ValueError: if actions are not relative: the coordinates of ``observation.state`` are then unknown.
    """
    if not config.privileged_key or not config.privileged_weight or meta is None:
        return None
    if config.action_frame != "relative":
        raise ValueError(
            f"privileged_key is {config.privileged_key!r}, but only action_frame='relative' knows the coordinates of "
            f"'observation.state'; action_frame is {config.action_frame!r}, so privileged_key must be ''."
        )
    return FrameColumn(meta, config.privileged_key, config.relative_dims)


def find_column(meta: Any, key: str) -> np.ndarray | None:
    """Return what ``read_column`` does, None if the dataset has no such column."""
    try:
        return read_column(meta, key, 1)
    except ValueError:
        return None


class PositionProbe(nn.Module):
    """Predicts a position from the tokens of a single frame, by attention pooling.

    Args:
        width: token size.
        n_dims: size of the position.
    """

    def __init__(self, width: int, n_dims: int) -> None:
        super().__init__()
        self.relevance = nn.Linear(width, 1)
        self.position = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, n_dims))

    def forward(self, tokens: Tensor) -> Tensor:
        """Map tokens ``(..., N, D)`` to positions ``(..., n_dims)``."""
        weights = self.relevance(tokens).softmax(dim=-2)  # (..., N, 1)
        return self.position((weights * tokens).sum(dim=-2))
