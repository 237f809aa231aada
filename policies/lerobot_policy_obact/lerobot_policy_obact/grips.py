"""Teaching to catch by contact: what the expert ``match`` answers for palms that were never there. Training only.

The expert is a function of where the palm is relative to the target, so virtual palms have labels here too, and virtual
hands follow it to the catch and beyond: a target in the hand goes where the hand goes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from dynahoi_lerobot.core.conventions import CONTROL_DT
from dynahoi_lerobot.experts.match import HELD_M, SEAT_M, STEP_M, approach, braked

if TYPE_CHECKING:
    from .recordings import Targets

NEAREST_M, FARTHEST_M = 0.004, 0.15
"""Least and greatest standard deviation by which virtual palms are moved, along each axis."""
SPREAD_M, CHANGE_SHARE = 0.06, 0.1
"""Greatest standard deviation of a virtual hand's error, along each axis, and share of the frames that redraw it."""
SLOWEST_SHARE = 0.5
"""Virtual hands make at least this share of the expert's way relative to the target."""
HELD_FRAMES = 24
"""A hand that holds its target is shown for at most this long."""
SEAT = torch.tensor(SEAT_M, dtype=torch.float32)


def grip_answers(targets: Targets, due: Tensor, palms: Tensor, horizon: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return where the expert moves palms ``(B, Q, M, 3)`` [m] in the frames after ``due`` ``(B, Q)``.

    Returns:
        Goals ``(B, Q, M, H, 3)`` [m], whether to close the fingers, 0 or 1, ``(B, Q, M, H)``, and about how many frames
        are left until the catch, ``(B, Q, M)``.
    """
    held = targets.held(due)[:, :, None]  # (B, Q, 1)
    path = targets.places(due[..., None] + torch.arange(horizon + 1), due) - SEAT  # (B, Q, H + 1, 3)
    offset = palms - path[:, :, None, 0]
    frames = (offset.norm(dim=-1) / STEP_M).ceil().long().clamp_min(1)
    goals, closing = [], []
    for step in range(1, horizon + 1):
        moved, closes = (torch.from_numpy(x) for x in approach(offset.numpy()))
        offset = torch.where(held[..., None], offset, moved.float())
        goals.append(path[:, :, None, step] + offset)
        closing.append(held | closes)
    return torch.stack(goals, dim=3), torch.stack(closing, dim=3).float(), frames


def grip_palms(targets: Targets, due: Tensor, palm: Tensor) -> Tensor:
    """Draw four palms for each decision, ``(B, Q, 4, 3)`` [m]; the first is where the palm was, ``(B, Q, 3)``.

    A palm that holds the target stays where it is.
    """
    seat = targets.places(due[..., None], due)[:, :, 0] - SEAT
    base = torch.stack([palm, palm, seat, seat], dim=2)
    spread = NEAREST_M * (FARTHEST_M / NEAREST_M) ** torch.rand(*base.shape[:3], 1)
    moved = torch.randn_like(base) * spread
    moved[:, :, 0] = 0.0
    return torch.where(targets.held(due)[..., None, None], palm[:, :, None], base + moved)


class GrippingHands:
    """Virtual hands that follow the expert with an error of their own, and hold the target once they have it."""

    def __init__(self, targets: Targets, window: Tensor, step_m: float) -> None:
        n, f = targets.path.shape[:2]
        self.window, self.step_m, self._targets = window, step_m, targets
        self.palm, self.velocity = torch.zeros(n, 3), torch.zeros(n, 3)
        self.carried = targets.places(torch.arange(f).repeat(n, 1, 1), window[:, None])[:, 0]
        self.contact = torch.full((n,), f)
        self.closed = torch.zeros(n)
        self.error = torch.zeros(n, 3)
        self.spread_m = SPREAD_M * torch.rand(n, 1) ** 2
        self.haste = SLOWEST_SHARE + (1 - SLOWEST_SHARE) * torch.rand(n, 1)

    @property
    def targets(self) -> Targets:
        """What is known of the targets after all that."""
        free = torch.minimum(self._targets.length, self.contact + HELD_FRAMES)
        return replace(self._targets, free=free, carried=self.carried, contact=self.contact)

    def place(self, t: int) -> Tensor:
        """Return where the targets are in frame ``t`` [m], ``(B, 3)``."""
        return self.carried[:, min(t, self.carried.shape[1] - 1)]

    def move(self, t: int) -> None:
        """Move the palms by a frame, from frame ``t``."""
        n, f = self.carried.shape[:2]
        if t + 1 >= f:
            return
        change = (torch.rand(n) < CHANGE_SHARE) | (self.window == t)
        self.error = torch.where(change[:, None], torch.randn(n, 3) * self.spread_m, self.error)
        path, acting, held = self.carried, (self.window <= t)[:, None], self.contact <= t
        offset = self.palm - (path[:, t] - SEAT)
        moved, closes = (torch.from_numpy(x) for x in approach((offset + self.error).numpy()))
        wanted = path[:, t + 1] - SEAT + offset + self.haste * (moved.float() - self.error - offset)
        way = (wanted - self.palm).clamp(-self.step_m, self.step_m)
        slower = torch.from_numpy(braked(self.velocity.numpy())).float()
        self.velocity = torch.where(held[:, None], slower, way / CONTROL_DT)
        way = torch.where(held[:, None], self.velocity * CONTROL_DT, way) * acting
        caught = ~held & closes & acting[:, 0] & (offset.norm(dim=-1) < HELD_M)
        self.contact = torch.where(caught, t + 1, self.contact)
        self.palm = self.palm + way
        self.closed = (held | (closes & acting[:, 0])).float()
        path[:, t + 1] = torch.where(held[:, None], path[:, t] + way, path[:, t + 1])
