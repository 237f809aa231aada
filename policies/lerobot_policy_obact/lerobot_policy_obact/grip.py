"""What a hand should do about a target that its fingers must hold. Training only.

The answers are those of dynahoi_lerobot's expert `match`, from wherever the palm is. The extra
``contact`` installs it.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from dynahoi_lerobot.experts.match import (
    HELD_M,
    HELD_SHARE,
    SEAT_M,
    SQUEEZE_RAD,
    STEP_M,
    approach,
    braked,
)

from .frames import palm_of
from .layers import smooth_norm
from .teacher import Answers, Targets, Teacher

GRIP_M = 0.015
"""A target that stays so near its seat in the hand, while fingers close, is gripped."""
STILL_FRAMES = 4
"""The palm must stay with the target for so long, which fingers take to close around it."""
HELD_FRAMES = 3
"""A virtual hand has caught its target after holding it for this many frames, in which it learns to
close its fingers all the way. More would mislead: the target is not carried along."""
BEGUN_SHARE, BEGUN_M = 0.2, 0.035
"""Fingers closed by more than this share, with the target this near its seat, go on to close all
the way. The expert's fingers are never half closed, but a policy that is unsure half closes them,
and would leave them so."""
DRAWN_SHARE = 0.5
"""Share of a decision's other hands whose fingers are closed at random, so that a policy does not
just repeat how far it has closed its own."""


class Grip(Teacher):
    """Come up from behind the target, move along with it, close the fingers, and brake.

    Recorded actions teach what to do once the target is in the hand.
    """

    def hands(self, targets: Targets, effect_at: Tensor, state: Tensor) -> Tensor:
        """See `Teacher.hands`; the fingers of some of the others are closed at random."""
        hands = super().hands(targets, effect_at, state)
        others = hands[:, :, 1:]
        closed = torch.rand(*others.shape[:3], 1, device=hands.device)
        joints = torch.lerp(self.open_joints.to(hands), self.closed_joints.to(hands), closed)
        drawn = torch.rand_like(closed) < DRAWN_SHARE
        fingers = torch.where(drawn, joints, others[..., 3:])
        others = torch.cat([others[..., :3], fingers], dim=-1)
        return torch.cat([hands[:, :, :1], others], dim=2)

    def answer(self, targets: Targets, effect_at: Tensor, hands: Tensor, horizon: int) -> Answers:
        """See `Teacher.answer`; every target can be reached."""
        palms = palm_of(hands)
        frames = effect_at[..., None] + torch.arange(horizon + 1, device=effect_at.device)
        places = targets.places(frames)[:, :, None]  # (B, Q, 1, H + 1, 3)
        offsets = palms - places[..., 0, :]
        joints = hands[..., 3:]
        held = self.holds(offsets, joints)
        offset = self._from_seat(offsets)
        distance = offset.norm(dim=-1)
        left = (distance / STEP_M).ceil().long().clamp_min(1)
        begun = (self._closed(joints) > BEGUN_SHARE) & (distance < BEGUN_M)
        velocity = (places[..., 1, :] - places[..., 0, :]).expand_as(palms) * self.fps  # [m/s]
        carried = palms
        goals = []
        closing = []
        for step in range(1, horizon + 1):
            offset, closes = _approach(offset)
            approached = places[..., step, :] - palms.new_tensor(SEAT_M) + offset
            velocity = _braked(velocity)
            carried = carried + velocity / self.fps
            goals.append(torch.where(held[..., None], carried, approached))
            closing.append(closes | begun | held)
        return Answers(
            goal=torch.stack(goals, dim=3),
            closing=torch.stack(closing, dim=3).to(palms),
            frames_left=left,
            reachable=torch.ones_like(left, dtype=torch.bool),
        )

    def misses(self, offsets: Tensor) -> Tensor:
        """See `Teacher.misses`: how far they are from where the target has its seat, on average
        while fingers close, or through all frames if there are fewer.
        """
        apart = smooth_norm(self._from_seat(offsets))
        return apart.unfold(1, min(STILL_FRAMES, apart.shape[1]), 1).mean(-1)

    def caught(self, offsets: Tensor, joints: Tensor) -> Tensor:
        """See `Teacher.caught`: after `HELD_FRAMES` in which it `holds` its target, or all frames
        if there are fewer.
        """
        n = min(HELD_FRAMES, offsets.shape[1])
        runs = self.holds(offsets, joints).unfold(1, n, 1).all(-1)
        return nn.functional.pad(runs, (n - 2, 0))

    def holds(self, offsets: Tensor, joints: Tensor) -> Tensor:
        """Return whether hands hold their targets, as the expert takes it: if fingers are closed
        and the target is near its seat, ``(...)``.

        Args:
            offsets: of palms from targets [m], ``(..., 3)``.
            joints: of the hands [rad], ``(..., J)``.
        """
        near = self._from_seat(offsets).norm(dim=-1) < HELD_M
        return near & (self._closed(joints) > HELD_SHARE)

    def joints(self, closing: Tensor) -> Tensor:
        """See `Teacher.joints`: closed farther than fingers around a target can, which makes them
        press.
        """
        return super().joints(closing) + SQUEEZE_RAD * closing[..., None]

    def _closed(self, joints: Tensor) -> Tensor:
        """Return how far fingers are closed, 0 open, 1 closed, ``(..., J) -> (...)``."""
        turned = (joints - self.open_joints.to(joints)).norm(dim=-1)
        return turned / (self.closed_joints - self.open_joints).norm()

    @staticmethod
    def _from_seat(offset: Tensor) -> Tensor:
        """Return how far a palm is from where the target has its seat, ``(..., 3)`` [m]."""
        return offset + offset.new_tensor(SEAT_M)


def _approach(offset: Tensor) -> tuple[Tensor, Tensor]:
    """Return what the expert's `approach` does, for tensors."""
    moved, closes = approach(offset.detach().cpu().double().numpy())
    return torch.from_numpy(moved).to(offset), torch.from_numpy(closes).to(offset.device)


def _braked(velocity: Tensor) -> Tensor:
    """Return what the expert's `braked` does, for tensors."""
    return torch.from_numpy(braked(velocity.detach().cpu().double().numpy())).to(velocity)
