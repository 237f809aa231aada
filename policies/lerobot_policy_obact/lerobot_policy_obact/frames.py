"""What was observed: frames of several episodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Self

import torch
from torch import Tensor

from .attention import Memory

if TYPE_CHECKING:
    from .belief import Outlook
    from .modeling_obact import ObActModel


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
        """Where the palm is [m], ``(B, T, 3)``."""
        return palm_of(self.state)

    def windows(self, rows: Tensor, ages_s: Tensor) -> Frames:
        """Return the frames of given ages ``(W,)`` [s] as seen from frames ``rows`` ``(B, Q)``, of ``(B * Q, W)``.

        For each age that is the frame nearest to it; before the first frame stands the first. Frames of all rows are as
        far apart as those of the first row.
        """
        wanted = self.time_s[rows][..., None] - ages_s  # (B, Q, W)
        middles = (self.time_s[1:] + self.time_s[:-1]) / 2
        index = torch.searchsorted(middles, wanted.contiguous(), right=True)
        batch = torch.arange(len(rows), device=rows.device)[:, None, None]
        sightings, state = (x[batch, index].flatten(0, 1) for x in (self.sightings, self.state))
        return Frames(
            sightings, state, torch.where(wanted[0, 0] < self.time_s[0], wanted[0, 0], self.time_s[index[0, 0]])
        )


def palm_of(state: Tensor) -> Tensor:
    """Return where palms are [m], ``(..., 3)``: the first entries of a state or action, as many as there are."""
    return torch.nn.functional.pad(state[..., :3], (0, max(0, 3 - state.shape[-1])))


def stepped(palm: Tensor, goal: Tensor, step_m: float) -> Tensor:
    """Return where palms ``(..., 3)`` [m] are a frame later that go towards their goals, at most ``step_m`` far."""
    way = goal - palm
    return palm + way * (step_m / (way.square().sum(-1, keepdim=True) + 1e-10).sqrt()).clamp_max(1.0)


class History:
    """Frames that come a few at a time, of which a model sees as many as its config says."""

    def __init__(self) -> None:
        self._memory = Memory()
        self._frames: Frames | None = None

    def see(self, model: ObActModel, frames: Frames) -> Outlook:
        """Return what a decision at the last of new frames, of ``(B, T)``, believes; later, B may be smaller."""
        if model.config.n_obs_frames is not None:
            if (kept := self._frames) is not None:
                n = len(frames.state)
                frames = Frames(
                    torch.cat([kept.sightings[:n], frames.sightings], 1),
                    torch.cat([kept.state[:n], frames.state], 1),
                    torch.cat([kept.time_s, frames.time_s]),
                )
            recent = frames.time_s[-1] - frames.time_s <= model.config.ages_s[0] + 1 / model.config.rig.fps
            frames = self._frames = Frames(frames.sightings[:, recent], frames.state[:, recent], frames.time_s[recent])
        n, t = frames.state.shape[:2]
        row = torch.full((n, 1), t - 1, device=frames.state.device)
        return model.encode_history(frames, row, self._memory)
