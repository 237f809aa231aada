"""Labels of a forecast from a dataset: where the target went, until it was caught, and how a hand closes around it.

They are right wherever the hand is: the path of a target that is not held does not depend on it. When the hand meets
the target does; there the teacher's goal, which is the label of every state, tells when it wanted to meet it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.utils.constants import ACTION
from torch import Tensor

from dynahoi_lerobot.dataset import episode_column

from .configuration_tracker import TrackerConfig
from .heads.base import ActionHead, ForecastHead
from .heads.intercept import KNOTS, PALM_DIM
from .privileged import find_column, read_column

CAUGHT = "localized"
"""Column that tells whether the target has been caught."""
PATH = "target_path"
"""Array of the episode table: the untouched target's position in every frame [m]."""
AT_GOAL_M = 1e-4
"""A goal that is the meeting point lies no further from the path."""
GRASP = "stats/reference_joints"
"""Column of the episode table: joint angles of the closed hand [rad]."""


@dataclass(frozen=True)
class ForecastLabels:
    """What a forecast at some frames is compared with; shapes without the leading ``(B, K)`` of samples and decisions.

    Attributes:
        path: position of the target at `KNOTS` after the frame, in the frame of the state [m], ``(n, 3)``.
        known: False where the episode has ended, or the target had been caught, ``(n,)``.
        closed: joints that close the hand around the target [rad], ``(J,)``.
        arrival: frames until the demonstrator, or the teacher from this state, meets the target, ``()``.
    """

    path: Tensor
    known: Tensor
    closed: Tensor
    arrival: Tensor


class Demonstrated:
    """The labels of a LeRobot dataset, by global frame index.

    Args:
        meta: the dataset's LeRobot metadata.
        key: column with the target's position, in the coordinates of ``observation.state``.

    Raises:
        ValueError: if the dataset has no such column, or does not tell when targets were caught.
    """

    def __init__(self, meta: Any, key: str) -> None:
        self.position = torch.from_numpy(read_column(meta, key, PALM_DIM)[:, :PALM_DIM])
        episode = read_column(meta, "episode_index", 1)[:, 0].astype(np.int64)
        caught = read_column(meta, CAUGHT, 1)[:, 0] > 0.5
        starts = np.flatnonzero(np.diff(episode, prepend=-1))
        ends = np.append(starts[1:], len(episode))
        spans = list(zip(starts, ends, strict=True))
        catches = [first + int(caught[first:end].argmax()) if caught[first:end].any() else end for first, end in spans]
        lengths = ends - starts
        self.end = torch.from_numpy(np.repeat(ends, lengths))  # (F,) first frame of the next episode
        self.catch = torch.from_numpy(np.repeat(np.array(catches), lengths))  # (F,) first frame with the target caught
        self.closed = torch.from_numpy(_grasps(meta, ends, lengths))  # (F, J)
        self.arrival = self.catch - torch.arange(len(episode))  # (F,)
        if (told := _arrivals(meta, spans)) is not None:
            self.arrival = torch.where(told > 0, told, self.arrival)

    def __call__(self, index: Tensor, offsets: list[int]) -> ForecastLabels:
        """Return the labels at frames ``index + offsets``, ``(B, K, ...)``.

        Args:
            index: global index of each sample's own frame, shape ``(B,)``.
            offsets: frames relative to it. Labels outside the sample's episode are arbitrary and must be masked.
        """
        frames = (index.cpu().reshape(-1, 1) + torch.tensor(offsets)).clamp(0, len(self.position) - 1)  # (B, K)
        ahead = frames[..., None] + torch.tensor(KNOTS)  # (B, K, n)
        held = (frames >= self.catch[frames])[..., None]  # a target that is held stays where it is
        ahead = torch.where(held, frames[..., None], ahead)
        known = (ahead < self.end[frames][..., None]) & (held | (ahead <= self.catch[frames][..., None]))
        path = self.position[ahead.clamp_max(len(self.position) - 1)]
        labels = (path, known, self.closed[frames], self.arrival[frames].clamp_min(1))
        return ForecastLabels(*(label.to(index.device) for label in labels))


def _arrivals(meta: Any, spans: list[tuple[int, int]]) -> Tensor | None:
    """Return in how many frames the teacher would meet the target, ``(F,)``, 0 where its goal is not on the path."""
    try:
        paths = episode_column(Path(meta.root), PATH)
    except ValueError:  # a dataset of somebody else
        return None
    goals = read_column(meta, ACTION, PALM_DIM)[:, :PALM_DIM]  # (F, 3)
    arrivals = np.zeros(len(goals), np.int64)
    for (first, end), path in zip(spans, paths, strict=True):
        frames = np.arange(end - first)[:, None]
        near = np.linalg.norm(goals[first:end, None] - path, axis=-1) < AT_GOAL_M  # (T, K)
        near &= np.arange(len(path)) > frames
        arrivals[first:end] = np.where(near.any(axis=1), near.argmax(axis=1) - frames[:, 0], 0)
    return torch.from_numpy(arrivals)


def _grasps(meta: Any, ends: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return the joints of each frame's grasp, ``(F, J)``: the known one, or else the last that were commanded."""
    if (known := find_column(meta, GRASP)) is not None:
        return known
    return np.repeat(read_column(meta, ACTION, PALM_DIM + 1)[ends - 1, PALM_DIM:], lengths, axis=0)


def demonstrated(head: ActionHead, config: TrackerConfig, meta: Any | None) -> Demonstrated | None:
    """Open the labels of a head that forecasts, if there is a dataset to train on.

    Args:
        head: the policy's head.
        config: the policy's config.
        meta: the dataset's LeRobot metadata; None while acting.

    Raises:
        ValueError: if the config names no column of the target's position.
    """
    if not isinstance(head, ForecastHead) or meta is None:
        return None
    if not config.privileged_key:
        raise ValueError(f"head {config.head!r} learns where targets go: privileged_key must name a column, got ''.")
    return Demonstrated(meta, config.privileged_key)
