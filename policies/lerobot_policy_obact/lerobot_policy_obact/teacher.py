"""What a hand should do about a target whose path is known, wherever its palm is. Training only.

What is believed about a target does not depend on where the palm is, so each decision is taken from
several palms at once, and a teacher answers for all of them: `Teacher` where the palm has to come
near enough, `Grip` where the fingers must hold the target.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from einops import repeat
from torch import Tensor

from .frames import Record, gather_frames

NEAREST_M, FARTHEST_M = (
    0.004,
    0.15,
)  # least and greatest standard deviation by which palms are moved, along each axis
LONGEST_FRAMES = 100  # a teacher looks this far ahead for a intercept
CLOSED_FRAMES, CLOSING_FRAMES = (
    24,
    8,
)  # fingers are closed this long before the intercept, and take this long to close
PLANNED_SPEED = 0.85
"""Share of the palm's speed limit that it plans with where that suffices: a palm that needs all of
it comes too late whenever the forecast was wrong."""
SLACK = 0.5
"""Within this share of the radius the palm has met the target. Without it, a hand that trails a
slightly faster target heads for a distant intercept instead of closing the last centimetres."""
NEVER = 1 << 20  # the frame of what does not happen
# fingers that must grip take this long to close, and until then the palm must stay with the
# target
STILL_FRAMES = 4


@dataclass(frozen=True)
class Targets(Record):
    """Where the targets of B episodes are."""

    path: Tensor  # of the untouched target [m], (B, F, 3)
    length: Tensor  # known frames of that, (B,)
    # frames in which there is something to decide: until the catch, or a little longer, (B,)
    free: Tensor
    carried: Tensor  # the path with what the hand does to the target [m], (B, F, 3)
    held: Tensor  # the frame from which on the hand holds the target, (B,)

    def is_held(self, frame: Tensor) -> Tensor:
        """Return whether targets are in the hand in frames ``(B, Q)``."""
        return frame >= self.held[:, None]

    def places(self, frame: Tensor, seen_from: Tensor) -> Tensor:
        """Return where targets are in frames ``(B, Q, K)`` [m], ``(B, Q, K, 3)``.

        Seen from frames ``(B, Q)`` before the catch, that is the untouched path.
        """
        index = torch.minimum(frame, self.length[:, None, None] - 1)
        held = self.is_held(seen_from)[..., None, None]
        return torch.where(
            held, gather_frames(self.carried, index), gather_frames(self.path, index)
        )


class Answers(NamedTuple):
    """What palms ``(B, Q, M)`` should do in the next H frames."""

    goal: Tensor  # where to go [m], (B, Q, M, H, 3)
    closing: Tensor  # how far the fingers should be closed, 0 open, 1 closed, (B, Q, M, H)
    frames: Tensor  # about how many are left until the intercept, (B, Q, M)
    reachable: Tensor  # whether the palm can be there in time, (B, Q, M)


@dataclass(frozen=True)
class Teacher:
    """Be where the target comes within a radius of the palm: at the earliest point of its path that
    is in reach.
    """

    fps: float  # frame rate [Hz]
    step_m: float  # how far a palm gets in a frame [m]
    open_joints: Tensor  # of the hand [rad], (J,)
    closed_joints: Tensor  # of the hand [rad], (J,)
    radius_m: float  # a target is caught where `misses` returns less [m]

    carries: ClassVar[bool] = (
        False  # whether a caught target goes where the hand goes, which is still to be decided
    )

    def answer(self, targets: Targets, due: Tensor, palms: Tensor, horizon: int) -> Answers:
        """Return what to do with palms ``(B, Q, M, 3)`` [m] in frames ``due`` ``(B, Q)``.

        A palm that is in time nowhere goes where it misses by least.
        """
        ahead = torch.arange(1, LONGEST_FRAMES + 1, device=due.device)
        frame = due[..., None] + ahead  # (B, Q, K)
        future = targets.places(frame, due)[:, :, None]  # (B, Q, 1, K, 3)
        known = (frame < targets.length[:, None, None])[:, :, None]
        distance = (future - palms[:, :, :, None]).norm(dim=-1)  # (B, Q, M, K)
        late = (distance - self.step_m * ahead).masked_fill(
            ~known, float("inf")
        )  # what the palm is short of [m]
        slack_m = SLACK * self.radius_m
        possible, planned = (
            late <= slack_m,
            known & (distance - PLANNED_SPEED * self.step_m * ahead <= slack_m),
        )
        reachable = possible.any(-1)
        possible = torch.where(planned.any(-1, keepdim=True), planned, possible)
        frames = torch.where(reachable, possible.int().argmax(-1), late.argmin(-1)) + 1
        chosen = repeat(frames - 1, "b q m -> b q m 1 i", i=3)
        intercept = future.expand(-1, -1, palms.shape[2], -1, -1).gather(3, chosen)
        left = frames[..., None] - torch.arange(horizon, device=due.device)
        closing = ((CLOSED_FRAMES + CLOSING_FRAMES - left) / CLOSING_FRAMES).clamp(0, 1)
        return Answers(intercept.expand(-1, -1, -1, horizon, -1), closing, frames, reachable)

    def caught(
        self, targets: Targets, frame: int, palm: Tensor, moved: Tensor, closed: Tensor
    ) -> Tensor:
        """Return whether hands ``(B,)``, ``closed`` or not, catch their targets between ``frame``
        and the next one, in which their palms are at ``palm`` and ``moved`` ``(B, 3)`` [m]: here,
        by the least distance.
        """
        start, end = (targets.path[:, min(frame + i, targets.path.shape[1] - 1)] for i in (0, 1))
        return (passing_distance(start - palm, end - moved) < self.radius_m) & (
            frame < targets.length - 1
        )

    def misses(self, offsets: Tensor) -> Tensor:
        """Return how far palms at ``offsets`` ``(B, R, 3)`` [m] from their targets are from
        catching, frame by frame, ``(B, R')`` [m], R' < R: here, by how much they pass them.
        """
        return passing_distance(offsets[:, :-1], offsets[:, 1:])

    def joints(self, closing: Tensor) -> Tensor:
        """Return commands to the joints [rad], ``(..., J)``, of hands that should be closed by
        ``(...)``.
        """
        opened, closed = self.open_joints.to(closing), self.closed_joints.to(closing)
        return torch.lerp(opened, closed, closing[..., None])

    def closed_share(self, joints: Tensor) -> Tensor:
        """Return how far joints ``(..., J)`` are closed, 0 open, 1 closed, ``(...)``."""
        return (joints - self.open_joints).sum(-1) / (self.closed_joints - self.open_joints).sum()

    def palms(self, targets: Targets, due: Tensor, palm: Tensor) -> Tensor:
        """Draw four palms for each decision, ``(B, Q, 4, 3)`` [m]: the one that was at ``palm``
        ``(B, Q, 3)`` in frames ``due`` ``(B, Q)``, and others near it and near the target. A palm
        that holds the target stays where it is.
        """
        place = targets.places(due[..., None], due)[:, :, 0]
        base = torch.stack([palm, palm, palm, place], dim=2)
        spread = NEAREST_M * (FARTHEST_M / NEAREST_M) ** torch.rand(
            *base.shape[:3], 1, device=base.device
        )
        moved = base + spread * torch.randn_like(base)
        moved[:, :, 0] = palm
        return torch.where(targets.is_held(due)[..., None, None], palm[:, :, None], moved)


class Grip(Teacher):
    """Close the fingers around the target, and brake with it in the hand: what the expert ``match``
    does.
    """

    carries: ClassVar[bool] = True

    @property
    def expert(self) -> Any:
        """The expert, which is a function of where the palm is relative to the target.

        Raises:
            ImportError: if it is not installed.
        """
        try:
            from dynahoi_lerobot.experts import match
        except ImportError as error:
            raise ImportError(
                "targets that must be gripped are learned from the expert 'match' of "
                "dynahoi_lerobot: install "
                "lerobot_policy_obact[contact]"
            ) from error
        return match

    @property
    def seat(self) -> Tensor:
        """Where a held target is, from the palm [m], ``(3,)``."""
        return torch.tensor(self.expert.SEAT_M, dtype=torch.float32)

    def joints(self, closing: Tensor) -> Tensor:
        """See `Teacher.joints`; they are commanded to close farther than they can, which is what
        holds the target.
        """
        opened, closed = self.open_joints.to(closing), self.closed_joints.to(closing)
        return torch.lerp(opened, closed + self.expert.SQUEEZE_RAD, closing[..., None])

    def answer(self, targets: Targets, due: Tensor, palms: Tensor, horizon: int) -> Answers:
        """See `Teacher.answer`."""
        held, n = targets.is_held(due)[:, :, None], horizon + 1
        frame = due[..., None] + torch.arange(-1, n, device=due.device)
        path = targets.places(frame, due) - self.seat.to(palms)  # (B, Q, H + 2, 3)
        velocity, path = (path[:, :, 1] - path[:, :, 0]) * self.fps, path[:, :, None, 1:]
        offset, carried = palms - path[..., 0, :], palms
        left = (offset.norm(dim=-1) / self.expert.STEP_M).ceil().long().clamp_min(1)
        goals, closing = [], []
        for step in range(1, n):
            moved, closes = (torch.from_numpy(x) for x in self.expert.approach(offset.numpy()))
            offset = moved.float()
            velocity = torch.from_numpy(self.expert.braked(velocity.numpy())).float()
            carried = carried + velocity[:, :, None] / self.fps
            goals.append(torch.where(held[..., None], carried, path[..., step, :] + offset))
            closing.append(held | closes)
        return Answers(
            torch.stack(goals, 3),
            torch.stack(closing, 3).float(),
            left,
            torch.ones_like(left).bool(),
        )

    def caught(
        self, targets: Targets, frame: int, palm: Tensor, moved: Tensor, closed: Tensor
    ) -> Tensor:
        """See `Teacher.caught`: by fingers that close around it."""
        last = targets.carried.shape[1] - 1
        offset = palm - (targets.carried[:, min(frame, last)] - self.seat)
        return closed & (offset.norm(dim=-1) < self.expert.HELD_M) & (frame < targets.length - 1)

    def misses(self, offsets: Tensor) -> Tensor:
        """See `Teacher.misses`: how far they are from where the target has its seat, while fingers
        close.
        """
        apart = ((offsets + self.seat.to(offsets)).square().sum(-1) + 1e-10).sqrt()
        return apart.unfold(1, STILL_FRAMES, 1).mean(-1)


def passing_distance(start: Tensor, end: Tensor) -> Tensor:
    """Return the least length ``(...)`` of vectors ``(..., 3)`` going from ``start`` to ``end`` in
    a straight line.
    """
    way = end - start
    share = (-(start * way).sum(-1) / way.square().sum(-1).clamp_min(1e-10)).clamp(0, 1).detach()
    return ((start + share[..., None] * way).square().sum(-1) + 1e-10).sqrt()
