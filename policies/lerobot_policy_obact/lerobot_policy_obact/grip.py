"""What a hand should do about a target that its fingers must hold. Training only.

The answers are those of dynahoi_lerobot's expert `match`, from wherever the palm is. The extra
``contact`` installs it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dynahoi_lerobot.experts.match import HELD_M, HELD_SHARE, SEAT_M, SQUEEZE_RAD, STEP_M, approach

from .teacher import Answers, Targets, Teacher

GRIP_M = 0.015
"""A target that stays so near its seat in the hand, while fingers close, is gripped."""
STILL_FRAMES = 4
"""The palm must stay with the target for so long, which fingers take to close around it."""


class Grip(Teacher):
    """Come up from behind the target, move along with it and close the fingers.

    Recorded actions teach what to do with a target in the hand.
    """

    def answer(self, targets: Targets, due: Tensor, palms: Tensor, horizon: int) -> Answers:
        """See `Teacher.answer`; every target can be reached."""
        frames = due[..., None] + torch.arange(horizon + 1, device=due.device)
        seat = targets.places(frames)[:, :, None] - palms.new_tensor(SEAT_M)  # (B, Q, 1, H + 1, 3)
        offset = palms - seat[..., 0, :]
        left = (offset.norm(dim=-1) / STEP_M).ceil().long().clamp_min(1)
        goals = []
        closing = []
        for step in range(1, horizon + 1):
            offset, closes = _approach(offset)
            goals.append(seat[..., step, :] + offset)
            closing.append(closes)
        return Answers(
            goal=torch.stack(goals, dim=3),
            closing=torch.stack(closing, dim=3).to(palms),
            frames=left,
            reachable=torch.ones_like(left, dtype=torch.bool),
        )

    def misses(self, offsets: Tensor) -> Tensor:
        """See `Teacher.misses`: how far they are from where the target has its seat, on average
        while fingers close.
        """
        apart = (self._from_seat(offsets).square().sum(-1) + 1e-10).sqrt()
        return apart.unfold(1, STILL_FRAMES, 1).mean(-1)

    def caught(self, offsets: Tensor, joints: Tensor) -> Tensor:
        """See `Teacher.caught`: a hand that `holds` its target has caught it."""
        return self.holds(offsets[:, 1:, None], joints[:, 1:])[..., 0]

    def holds(self, offsets: Tensor, joints: Tensor) -> Tensor:
        """See `Teacher.holds`: as the expert takes it, if fingers are closed and the target is near
        its seat.
        """
        turned = (joints - self.open_joints.to(joints)).norm(dim=-1)
        closed = turned > HELD_SHARE * (self.closed_joints - self.open_joints).norm()
        return closed[..., None] & (self._from_seat(offsets).norm(dim=-1) < HELD_M)

    def pursued(self, state: Tensor, place: Tensor, next_place: Tensor) -> Tensor:
        """See `Teacher.pursued`: along with the target, closer to it, and then closed."""
        offset, closes = _approach(self._from_seat(state[:, :3] - place))
        palm = next_place - state.new_tensor(SEAT_M) + offset
        return torch.cat([palm, self.joints(closes.to(state))], dim=-1)

    def joints(self, closing: Tensor) -> Tensor:
        """See `Teacher.joints`: closed farther than fingers around a target can, which makes them
        press.
        """
        return super().joints(closing) + SQUEEZE_RAD * closing[..., None]

    @staticmethod
    def _from_seat(offset: Tensor) -> Tensor:
        """Return how far a palm is from where the target has its seat, ``(..., 3)`` [m]."""
        return offset + offset.new_tensor(SEAT_M)


def _approach(offset: Tensor) -> tuple[Tensor, Tensor]:
    """Return what the expert's `approach` does, for tensors."""
    moved, closes = approach(offset.detach().cpu().double().numpy())
    return torch.from_numpy(moved).to(offset), torch.from_numpy(closes).to(offset.device)
