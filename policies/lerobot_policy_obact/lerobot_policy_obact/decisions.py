"""What a decision is made from and learned from: observed frames, and what should have been done."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Self

import torch
from lerobot.utils.constants import ACTION
from torch import Tensor

if TYPE_CHECKING:
    from .configuration_obact import ObActConfig


@dataclass(frozen=True)
class Record:
    """Tensors, and records of those, by name."""

    def to(self, device: str | torch.device) -> Self:
        """Return it with all that it holds on a device."""
        held = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: x.to(device) for name, x in held.items() if x is not None})


@dataclass(frozen=True)
class Frames(Record):
    """T frames of B episodes, in the order of time.

    Attributes:
        sightings: by camera (u, v, log depth) and two log scales, then what else the encoder says, ``(B, T, C, 5 +
            E)``.
        state: of the robot, ``(B, T, S)``.
        time_s: when they were seen [s], ``(T,)``.
    """

    sightings: Tensor
    state: Tensor
    time_s: Tensor

    @property
    def palm(self) -> Tensor:
        """Where the palm is [m], ``(B, T, 3)``: the first entries of the state, as many as there are."""
        return torch.nn.functional.pad(self.state[..., :3], (0, max(0, 3 - self.state.shape[-1])))

    def until(self, last: int) -> Frames:
        """Return the frames up to number ``last``."""
        return Frames(self.sightings[:, : last + 1], self.state[:, : last + 1], self.time_s[: last + 1])

    def windows(self, index: Tensor, time_s: Tensor) -> Frames:
        """Return windows ``(B * Q, W)`` of frames ``(B, Q, W)``, seen at ``time_s`` ``(W,)``; frame 0 repeats."""
        rows, held = torch.arange(len(index), device=index.device)[:, None, None], index.clamp_min(0)
        return Frames(self.sightings[rows, held].flatten(0, 1), self.state[rows, held].flatten(0, 1), time_s)


@dataclass(frozen=True)
class Future(Record):
    """Where the target will be at the K times of a forecast.

    Attributes:
        place: there [m], ``(B, Q, K, 3)``.
        known: which of those are known, ``(B, Q, K)``.
        near: weight of each time by how near it is to the meeting, ``(B, Q, K)``.
    """

    place: Tensor
    known: Tensor
    near: Tensor

    def loss(self, forecast: Tensor, ahead_s: Tensor) -> Tensor:
        """Return the loss of forecasts ``(B, Q, K, 3)`` [m] by episode, ``(B,)``; it is largest near the meeting."""
        error = ((forecast - self.place).square().sum(-1) + 1e-8).sqrt() * self.known
        return (error / (0.05 + 0.3 * ahead_s)).mean((1, 2)) + 10 * (error * self.near).sum(-1).mean(1)


@dataclass(frozen=True)
class Decisions(Record):
    """Decisions and what they should have been: Q in each of B episodes, each from M palms.

    Attributes:
        frames: what was observed, ``(B, T)``.
        rows: frames of the decisions, ``(B, Q)``.
        palm: where the palm is when the command takes effect [m], ``(B, Q, M, 3)``.
        state: of the robot, ``(B, Q, M, S)``.
        actions: the right ones, ``(B, Q, M, H, A)``.
        weight: of each, 0 for padding, ``(B, Q, M, H)``.
        future: where the target will be; None if nobody knows.
    """

    frames: Frames
    rows: Tensor
    palm: Tensor
    state: Tensor
    actions: Tensor
    weight: Tensor
    future: Future | None = None


def observed(batch: dict[str, Any], sightings: Tensor, state: Tensor, config: ObActConfig) -> Decisions:
    """Return the decisions of a batch of windows, one a sample.

    Args:
        batch: LeRobot batch with ``action`` ``(B, H, A)``.
        sightings: of the window's images, ``(B, T, C, 5 + E)``.
        state: of the robot in it, ``(B, T, S)``.
        config: of the policy.
    """
    n = len(state)
    time_s = torch.tensor(config.lookback, device=state.device) / config.fps
    frames = Frames(sightings, state, time_s)
    padding = batch.get(f"{ACTION}_is_pad")
    weight = torch.ones(batch[ACTION].shape[:2], device=state.device) if padding is None else (~padding).float()
    rows = torch.full((n, 1), state.shape[1] - 1, device=state.device)
    now = slice(-1, None)
    return Decisions(
        frames,
        rows,
        frames.palm[:, now, None],
        state[:, now, None],
        batch[ACTION][:, None, None],
        weight[:, None, None],
    )
