"""Tensors by frame: what is kept of the observation history, and where palms get in a frame."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class Record:
    """Tensors, and records of those, by name."""

    def map(self, change: Callable[[Any], Any]) -> Self:
        """Return it with all that it holds changed."""
        held = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: change(x) for name, x in held.items() if x is not None})

    def to(self, device: str | torch.device) -> Self:
        """Return it with all that it holds on a device."""
        return self.map(lambda x: x.to(device))

    def __getitem__(self, index: Any) -> Self:
        """Return it with all that it holds indexed, where all tensors begin with the same axes."""
        return self.map(lambda x: x[index])


@dataclass(frozen=True)
class Frames(Record):
    """T frames of B episodes, in the order of time."""

    # by camera (u, v, log depth) and two log scales, then the embedding, (B, T, C, 5 + E)
    sightings: Tensor
    state: Tensor  # of the robot, (B, T, S)
    time_s: Tensor  # when they were seen [s], (T,)
    # frames before the first one of an episode, which nobody has seen, (B, T); None if there are
    # none
    hidden: Tensor | None = None

    @property
    def palm(self) -> Tensor:
        """Where the palm is [m], ``(B, T, 3)``."""
        return palm_of(self.state)

    def __getitem__(self, index: Any) -> Self:
        """Return those of some episodes; all have the same times."""
        chosen = {"sightings": self.sightings[index], "state": self.state[index]}
        hidden = None if self.hidden is None else self.hidden[index]
        return replace(self, **chosen, hidden=hidden)


def gather_frames(table: Tensor, frame: Tensor) -> Tensor:
    """Return what tables ``(B, T, ...)`` hold for frames ``(B, Q...)``, ``(B, Q..., ...)``."""
    rows = torch.arange(len(frame), device=frame.device)
    return table[rows.view(-1, *[1] * (frame.dim() - 1)), frame]


def palm_of(state: Tensor) -> Tensor:
    """Return where palms are [m], ``(..., 3)``: the first entries of a state or action, as many as
    there are.
    """
    return nn.functional.pad(state[..., :3], (0, max(0, 3 - state.shape[-1])))


def stepped(palm: Tensor, goal: Tensor, step_m: float) -> Tensor:
    """Return where palms ``(..., 3)`` [m] are a frame later that go towards their goals, at most
    ``step_m`` far.
    """
    way = goal - palm
    reach = step_m / (way.square().sum(-1, keepdim=True) + 1e-10).sqrt()
    return palm + way * reach.clamp_max(1.0)
