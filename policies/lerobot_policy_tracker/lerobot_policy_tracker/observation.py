"""The observation of a LeRobot batch: images at model size, vectors concatenated, one padding mask."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from lerobot.utils.constants import OBS_STATE
from torch import Tensor

from .configuration_tracker import TrackerConfig
from .replan import indicator, rise_threshold, risen

Batch = Mapping[str, Any]
"""A preprocessed LeRobot batch: tensors by key, and the instruction(s) under "task"."""


@dataclass(frozen=True)
class Observation:
    """``T`` frames of ``B`` samples, oldest first.

    Attributes:
        images: RGB in [0, 1] of ``C`` cameras, shape ``(B, T, C, 3, H, W)``; where ``config.motion`` is set, each with
            the image before it in three further channels.
        proprioception: all vector observations concatenated, normalised, shape ``(B, T, S)``.
        position: ``observation.state``, normalised, the reference of relative actions, shape ``(B, T, P)``; P may be
            0.
        keep: False where a frame is padding, shape ``(B, T)``.
        watching: True where a frame is part of the observation window, shape ``(B, T)``.
        texts: one instruction per sample.
    """

    images: Tensor
    proprioception: Tensor
    position: Tensor
    keep: Tensor
    watching: Tensor
    texts: list[str]

    @classmethod
    def from_batch(cls, batch: Batch, config: TrackerConfig) -> Observation:
        """Read a preprocessed LeRobot batch, with a time axis (dataset) or without one (environment).

        Without its ``replan_key``, which robots and LeRobot's asynchronous server do not send, the hand may move.
        """
        images = torch.stack(
            [_resize(_with_time(batch[key], 5), config.image_size) for key in config.image_features], 2
        )
        shape, device = images.shape[:2], images.device
        vectors = [_vector(batch, key, config, images) for key in config.proprioceptive_keys]
        empty = torch.zeros(*shape, 0, device=device)
        observation = cls(
            images=images,
            proprioception=torch.cat(vectors, dim=-1) if vectors else empty,
            position=_with_time(batch[OBS_STATE], 3) if config.robot_state_feature else empty,
            keep=_frame_mask(batch, shape, device),
            watching=_watching(batch, config, shape, device),
            texts=_texts(batch, shape[0]),
        )
        loaded = config.observation_delta_indices
        if not config.motion or shape[1] != len(loaded) or shape[1] == 1:
            return observation
        places = {offset: place for place, offset in enumerate(loaded)}
        shown = config.windows.observation_offsets
        before = images[:, [places[offset - 1] for offset in shown]]
        return observation.frames([places[offset] for offset in shown]).after(before)

    def after(self, before: Tensor) -> Observation:
        """Return the frames with the images ``(B, T, C, 3, H, W)`` before theirs."""
        return replace(self, images=torch.cat([self.images, before], dim=3))

    def frames(self, index: list[int]) -> Observation:
        """Return the frames at ``index`` of every sample."""
        return Observation(
            self.images[:, index],
            self.proprioception[:, index],
            self.position[:, index],
            self.keep[:, index],
            self.watching[:, index],
            self.texts,
        )


def _with_time(x: Tensor, n_axes: int) -> Tensor:
    return x if x.dim() == n_axes else x.unsqueeze(1)  # (B, ...) -> (B, 1, ...)


def _vector(batch: Batch, key: str, config: TrackerConfig, images: Tensor) -> Tensor:
    """Return a vector observation of the frames of ``images``, ``(B, T, D)``."""
    if key == config.replan_key and key not in batch:
        return risen(config).to(images.device).expand(*images.shape[:2], -1)
    return _with_time(batch[key], 3).reshape(*images.shape[:2], -1)


def _resize(images: Tensor, size: int) -> Tensor:
    if size in (0, images.shape[-1]) and images.shape[-1] == images.shape[-2]:
        return images
    flat = images.flatten(0, 1)  # (B, T, 3, H, W) -> (B*T, 3, H, W)
    target = (size, size) if size else images.shape[-2:]
    resized = F.interpolate(flat, target, mode="bilinear", antialias=True, align_corners=False)
    return resized.unflatten(0, images.shape[:2])


def _frame_mask(batch: Batch, shape: torch.Size, device: torch.device) -> Tensor:
    pads = [value for key, value in batch.items() if key.startswith("observation.") and key.endswith("_is_pad")]
    return ~_with_time(pads[0].bool(), 2) if pads else torch.ones(*shape, dtype=torch.bool, device=device)


def _watching(batch: Batch, config: TrackerConfig, shape: torch.Size, device: torch.device) -> Tensor:
    """Return which frames precede the rise of ``replan_key``; without that key any frame may be remembered."""
    value = indicator(batch, config, *shape)
    if value is None:
        return torch.ones(*shape, dtype=torch.bool, device=device)
    return value < rise_threshold(config, None)


def _texts(batch: Batch, n: int) -> list[str]:
    task = batch.get("task", "")
    return [task] * n if isinstance(task, str) else list(task)
