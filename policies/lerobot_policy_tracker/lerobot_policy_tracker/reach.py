"""Where a hand of limited speed can first meet a target whose path is expected, and how it goes and closes to do so.

A mean over possible next steps is shorter than any of them, and a hand without slack never makes that up. So the path
is predicted, and the step follows from it: straight, at full speed, to the earliest point that can be reached in time.
Frames are counted from the one at which the next command takes effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

CONTACT_M = 0.03
"""The fingers must be closed when the target comes this close to the palm's centre."""
CLOSED_EARLY_FRAMES = 1
"""A hand that cannot close sooner arrives this much later: it may touch the target a little before it is there."""
SUBFRAMES = 5
"""Points in each frame at which the distance of palm and target is looked at, so that a fast target is not missed."""


@dataclass(frozen=True)
class Reach:
    """How far a hand moves within one frame, and how early it closes.

    Attributes:
        palm_step_m: of the palm [m].
        joint_step_rad: of each joint [rad].
        spare_frames: fingers are closed this long before the target is expected within reach of them.
        closing_frames: fingers close over at most this many frames.
    """

    palm_step_m: float
    joint_step_rad: float
    spare_frames: int
    closing_frames: int


@dataclass(frozen=True)
class Meeting:
    """Where and when ``B`` hands plan to meet their targets.

    Attributes:
        offset: of the meeting point from where the hand is when the next command takes effect [m], shape ``(B, 3)``.
        frames: until then, at least 1, shape ``(B,)``.
    """

    offset: Tensor
    frames: Tensor


def executed(start: Tensor, actions: Tensor, length: Tensor, reach: Reach) -> Tensor:
    """Return where hands are after the first actions of a sequence, each as far as a frame allows, ``(B, A)``.

    Args:
        start: where they are, palm [m] and joints [rad], shape ``(B, A)``.
        actions: absolute targets in the same frame, shape ``(B, D, A)``.
        length: how many of them are executed, shape ``(B,)``.
        reach: the hand.
    """
    for number, action in enumerate(actions.unbind(1)):
        palm, joints = (action - start)[:, :3], (action - start)[:, 3:]
        palm = palm * (reach.palm_step_m / palm.norm(dim=-1, keepdim=True).clamp_min(1e-9)).clamp_max(1.0)
        step = torch.cat([palm, joints.clamp(-reach.joint_step_rad, reach.joint_step_rad)], dim=-1)
        start = torch.where((number < length)[:, None], start + step, start)
    return start


def earliest_meeting(path: Tensor, turn_rad: Tensor, reach: Reach) -> Meeting:
    """Return the earliest point of each path that a hand can reach in time, with closed fingers; else the last one.

    Args:
        path: expected offsets of the targets from the hands' start [m], shape ``(B, F + 1, 3)`` for frames 0 to F.
        turn_rad: how far the joint that has the longest way must turn [rad], shape ``(B,)``.
        reach: the hand.
    """
    frames = torch.arange(1, path.shape[1], device=path.device)
    possible = path[:, 1:].norm(dim=-1) <= reach.palm_step_m * frames  # (B, F)
    possible = possible & (reach.joint_step_rad * (frames - CLOSED_EARLY_FRAMES) >= turn_rad[:, None])
    possible[:, -1] = True
    arrival = possible.int().argmax(1) + 1
    return Meeting(path[torch.arange(len(path)), arrival], arrival)


def palm_path(path: Tensor, meeting: Meeting, reach: Reach) -> Tensor:
    """Return where each palm will be, from frame 0 on, relative to its start [m], ``(B, F + 1, 3)``.

    It goes to the meeting point at full speed, waits there, and then stays with the target.
    """
    frames = torch.arange(path.shape[1], device=path.device)
    way_m = meeting.offset.norm(dim=-1, keepdim=True).clamp_min(1e-6)  # (B, 1)
    progress = (reach.palm_step_m * frames / way_m).clamp_max(1.0)  # (B, F + 1)
    straight = progress[..., None] * meeting.offset[:, None]
    return torch.where((frames > meeting.frames[:, None])[..., None], path, straight)


def first_contact(palm: Tensor, path: Tensor) -> Tensor:
    """Return the first frame, at least 1, by which palms and targets ``(B, F + 1, 3)`` meet, else F; ``(B,)``."""
    gap = palm - path
    share = torch.arange(1, SUBFRAMES + 1, device=path.device)[:, None] / SUBFRAMES
    fine = torch.lerp(gap[:, :-1, None], gap[:, 1:, None], share)  # (B, F, SUBFRAMES, 3)
    inside = (fine.norm(dim=-1) < CONTACT_M).any(-1)
    inside[:, -1] = True
    return inside.int().argmax(1) + 1


def close_in_time(joints: Tensor, closed: Tensor, contact: Tensor, n_steps: int, reach: Reach) -> Tensor:
    """Return joints after 1 to ``n_steps`` frames that are closed shortly before contact, ``(B, n_steps, 15)`` [rad].

    Args:
        joints: where they are [rad], shape ``(B, J)``.
        closed: where they should be at contact [rad], shape ``(B, J)``.
        contact: frames until then, shape ``(B,)``.
        n_steps: how many frames are wanted.
        reach: the hand.
    """
    steps = []
    for done in range(n_steps):
        left = (contact - reach.spare_frames - done)[:, None]  # (B, 1)
        turn = ((closed - joints) / left.clamp_min(1)).clamp(-reach.joint_step_rad, reach.joint_step_rad)
        joints = torch.where(left > reach.closing_frames, joints, joints + turn)
        steps.append(joints)
    return torch.stack(steps, dim=1)
