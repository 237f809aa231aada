"""What a hand should do about a target whose path is known, wherever its palm is. Training only.

What is expected of a target does not depend on where the palm is, so each decision is taken from
several palms at once, and the teacher answers for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from einops import repeat
from torch import Tensor

from .frames import Record, gather_frames, palm_of
from .layers import smooth_norm

LEAST_SPREAD_M = 0.004
GREATEST_SPREAD_M = 0.15
"""Standard deviations, along each axis, by which palms are moved: from the last corrections to a
target that is about to be missed. Not tuned."""
LONGEST_FRAMES = 100  # a teacher looks this far ahead for an intercept
CLOSED_FRAMES = 24
"""Fingers are closed this long before the intercept, or a policy that comes to it early would be
caught open. The expert that records closes them 16 frames before. Recordings with 24, half of them
with perturbed palms, had S_joint 70.9 instead of 67.3, within noise (`docs/notes/experiments.md`);
for these labels alone it was not measured."""
CLOSING_FRAMES = 8  # which fingers take to close, as those of that expert
PLANNED_SPEED = 0.85
"""Share of the palm's speed limit that it plans with where that suffices: a palm that needs all of
it comes too late whenever the forecast was wrong. Not tuned."""
SLACK = 0.5
"""Within this share of the radius the palm has met the target. Without it, a hand that trails a
slightly faster target heads for a distant intercept instead of closing the last centimeters: S_loc
was 80 instead of 85 (`docs/notes/decisions.md`)."""


@dataclass(frozen=True)
class Targets(Record):
    """Where the targets of B episodes are, whatever the hand does."""

    path: Tensor  # [m], (B, F, 3)
    length: Tensor  # known frames of that, (B,)
    catch: Tensor  # the frame in which the hand has caught them; nothing is decided after it, (B,)
    # whether the recorded hand grips them in the current frame, so that its actions are learned,
    # (B,)
    gripped: Tensor

    def places(self, frame: Tensor) -> Tensor:
        """Return where targets are in frames ``(B, Q, K)`` [m], ``(B, Q, K, 3)``."""
        return gather_frames(self.path, torch.minimum(frame, self.length[:, None, None] - 1))


class Answers(NamedTuple):
    """What palms ``(B, Q, M)`` should do in the next H frames."""

    goal: Tensor  # where to go [m], (B, Q, M, H, 3)
    closing: Tensor  # how far the fingers should be closed, 0 open, 1 closed, (B, Q, M, H)
    frames_left: Tensor  # about how many there are until the intercept, (B, Q, M)
    reachable: Tensor  # whether the palm can be there in time, (B, Q, M)


@dataclass(frozen=True)
class Teacher:
    """Be where the target comes within a radius of the palm: at the earliest point of its path that
    is in reach.

    It labels decisions of virtual hands. What the core calls a teacher is another one: the expert
    that records, whose goals are the ``action`` of a dataset.
    """

    fps: float  # frame rate [Hz]
    step_m: float  # how far a palm gets in a frame [m]
    open_joints: Tensor  # of the hand [rad], (J,)
    closed_joints: Tensor  # of the hand [rad], (J,)
    radius_m: float  # within which a target is caught, as `misses` measures it [m]

    def answer(self, targets: Targets, effect_at: Tensor, hands: Tensor, horizon: int) -> Answers:
        """Return what hands should do from frames ``effect_at`` ``(B, Q)`` on, in which they are in
        states ``hands`` ``(B, Q, M, S)``.

        A palm that is in time nowhere goes where it misses by least.
        """
        palms = palm_of(hands)
        ahead = torch.arange(1, LONGEST_FRAMES + 1, device=effect_at.device)
        frame = effect_at[..., None] + ahead  # (B, Q, K)
        future = targets.places(frame)[:, :, None]  # (B, Q, 1, K, 3)
        known = (frame < targets.length[:, None, None])[:, :, None]
        distance = (future - palms[:, :, :, None]).norm(dim=-1)  # (B, Q, M, K)
        # what the palm is short of [m]
        short_m = (distance - self.step_m * ahead).masked_fill(~known, float("inf"))
        slack_m = SLACK * self.radius_m
        possible = short_m <= slack_m
        planned = known & (distance - PLANNED_SPEED * self.step_m * ahead <= slack_m)
        reachable = possible.any(-1)
        possible = torch.where(planned.any(-1, keepdim=True), planned, possible)
        chosen = torch.where(reachable, possible.int().argmax(-1), short_m.argmin(-1))
        intercept = torch.take_along_dim(future, chosen[..., None, None], dim=3)
        frames_left = chosen + 1
        left = frames_left[..., None] - torch.arange(horizon, device=effect_at.device)
        closing = ((CLOSED_FRAMES + CLOSING_FRAMES - left) / CLOSING_FRAMES).clamp(0, 1)
        return Answers(intercept.expand(-1, -1, -1, horizon, -1), closing, frames_left, reachable)

    def misses(self, offsets: Tensor) -> Tensor:
        """Return how far palms at ``offsets`` ``(B, R, 3)`` [m] from their targets are from
        catching, frame by frame, ``(B, R')`` [m], R' < R: here, by how much they pass them.
        """
        return passing_distance(offsets[:, :-1], offsets[:, 1:])

    def caught(self, offsets: Tensor, joints: Tensor) -> Tensor:
        """Return whether hands whose palms are at ``offsets`` ``(B, R, 3)`` [m] from their targets,
        and whose joints ``(B, R, J)`` [rad], catch them from frame to frame, ``(B, R - 1)``.
        """
        return self.misses(offsets) < self.radius_m

    def joints(self, closing: Tensor) -> Tensor:
        """Return commands to the joints [rad], ``(..., J)``, of hands that should be closed by
        ``(...)``.
        """
        opened = self.open_joints.to(closing)
        closed = self.closed_joints.to(closing)
        return torch.lerp(opened, closed, closing[..., None])

    def hands(self, targets: Targets, effect_at: Tensor, state: Tensor) -> Tensor:
        """Draw the states of four hands for each decision, ``(B, Q, 4, S)``: of the one that was in
        ``state`` ``(B, Q, S)`` in frames ``effect_at`` ``(B, Q)``, and of others with their palms
        near it and near the target.
        """
        place = targets.places(effect_at[..., None])[:, :, 0]
        palm = palm_of(state)
        base = torch.stack([palm, palm, palm, place], dim=2)
        # spread evenly over the orders of magnitude
        share = torch.rand(*base.shape[:3], 1, device=base.device)
        spread = LEAST_SPREAD_M * (GREATEST_SPREAD_M / LEAST_SPREAD_M) ** share
        moved = base + spread * torch.randn_like(base)
        moved[:, :, 0] = palm
        rest = repeat(state[..., 3:], "b q j -> b q m j", m=4)
        return torch.cat([moved, rest], dim=-1)


def passing_distance(start: Tensor, end: Tensor) -> Tensor:
    """Return the least length ``(...)`` of vectors ``(..., 3)`` going from ``start`` to ``end`` in
    a straight line.
    """
    step = end - start
    share = (-(start * step).sum(-1) / step.square().sum(-1).clamp_min(1e-10)).clamp(0, 1).detach()
    return smooth_norm(start + share[..., None] * step)
