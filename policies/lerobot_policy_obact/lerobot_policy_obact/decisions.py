"""What is learned from: episodes, decisions in them, and what should have been done. Training only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from einops import repeat
from torch import Tensor

from .belief import FORECAST_FRAMES
from .frames import Frames, Record, palm_of
from .teacher import Targets, Teacher

if TYPE_CHECKING:
    from .configuration_obact import ObActConfig

EARLY_SHARE, EARLIEST_FRAME = 0.15, 3
"""Share of the decisions that are taken anywhere in the observation window, and the first frame at which."""
UNREACHABLE_WEIGHT = 0.1
"""Weight of what should be done about a target that is out of reach."""


@dataclass(frozen=True)
class Episodes:
    """B episodes of T frames; one that is over repeats its last frame.

    Attributes:
        sightings, state, actions: of the frames, ``(B, T, ...)``.
        count: frames of each, ``(B,)``.
        window: frames of the observation window, ``(B,)``.
        fps: frame rate [Hz].
        targets: what is known of the targets; None if nothing is.
    """

    sightings: Tensor
    state: Tensor
    actions: Tensor
    count: Tensor
    window: Tensor
    fps: float
    targets: Targets | None

    def frames(self, rows: Tensor) -> Frames:
        """Return the frames up to the last of ``rows``."""
        n = int(rows.max()) + 1
        return Frames(self.sightings[:, :n], self.state[:, :n], torch.arange(n) / self.fps)

    def palm(self, frame: Tensor) -> Tensor:
        """Return where the palm is in frames ``(B, Q)`` [m], ``(B, Q, 3)``."""
        batch = torch.arange(len(frame))[:, None]
        return palm_of(self.state[batch, frame.clamp_max(self.state.shape[1] - 1)])

    def decision_rows(self, n: int, late: int) -> Tensor:
        """Draw frames at which decisions are taken, ``(B, n)``: mostly where the hand may move."""
        last = self.count - 1 - late
        if self.targets is not None:
            last = torch.minimum(last, torch.minimum(self.targets.length - 3 - late, self.targets.free - 1))
        last = last.clamp_min(EARLIEST_FRAME + 1)[:, None]
        start = torch.where(torch.rand(len(last), n) < EARLY_SHARE, EARLIEST_FRAME, self.window[:, None])
        start = torch.minimum(start, last - 1)
        return torch.minimum(start + (torch.rand(start.shape) * (last - start + 0.999)).long(), last)

    def decisions(self, rows: Tensor, teacher: Teacher | None, config: ObActConfig) -> Decisions:
        """Return decisions at ``rows`` ``(B, Q)``: what was done there, or the teacher's answers for several palms."""
        batch = torch.arange(len(rows))[:, None]
        state, late = self.state[batch, rows][:, :, None], config.rig.delay_frames
        palm = self.palm(rows + late)
        if self.targets is None or teacher is None:
            ahead, last = rows[..., None] + torch.arange(config.horizon), self.count[:, None, None] - 1  # (B, Q, H)
            actions, weight = self.actions[batch[..., None], torch.minimum(ahead, last)], (ahead <= last).float()
            return Decisions(palm[:, :, None], state, actions[:, :, None], weight[:, :, None])
        targets = self.targets
        due = torch.minimum(rows + late, targets.length[:, None] - 2)
        palms = teacher.palms(targets, due, palm)
        told = teacher.answer(targets, due, palms, config.horizon)
        index = rows[..., None] + torch.tensor(FORECAST_FRAMES)
        weight = torch.where(told.reachable, 1.0, UNREACHABLE_WEIGHT)
        return Decisions(
            palm=palms,
            state=state.expand(-1, -1, palms.shape[2], -1),
            actions=torch.cat([told.goal, teacher.joints(told.closing)], dim=-1),
            weight=repeat(weight, "b q m -> b q m h", h=config.horizon),
            future=Future(
                place=targets.places(index, rows),
                known=index < targets.length[:, None, None],
                near=_nearness(told.frames + late, told.reachable),
            ),
        )


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


def _nearness(frames: Tensor, reachable: Tensor) -> Tensor:
    """Return the weight of each time of the forecast for meetings in ``frames`` ``(B, Q, M)``, ``(B, Q, K)``."""
    left = frames.clamp_max(FORECAST_FRAMES[-1]).float()[..., None]
    weight = (1 - (torch.tensor(FORECAST_FRAMES) - left).abs() / (1 + 0.25 * left)).clamp_min(0)
    return (weight / weight.sum(-1, keepdim=True).clamp_min(1e-6) * reachable[..., None]).mean(2)


@dataclass(frozen=True)
class Decisions(Record):
    """What Q decisions in each of B episodes should have been, from each of M palms.

    Attributes:
        palm: where the palm is when the command takes effect [m], ``(B, Q, M, 3)``.
        state: of the robot, ``(B, Q, M, S)``.
        actions: the right ones, ``(B, Q, M, H, A)``.
        weight: of each, 0 for padding, ``(B, Q, M, H)``.
        future: where the target will be; None if nobody knows.
    """

    palm: Tensor
    state: Tensor
    actions: Tensor
    weight: Tensor
    future: Future | None = None
