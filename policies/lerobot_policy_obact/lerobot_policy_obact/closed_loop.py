"""The closed-loop loss: how near a palm comes to the target that goes where the policy sends it. Training only.

A teacher that knows the future cannot be imitated before the future can be known; and nothing in imitation tells a
policy that a forecast which is wrong now will be less wrong in five frames. So from a frame on the palm alone is rolled
out through the head, each command cut to what a palm does in a frame, and what counts is how near it comes to catching
the target, as its teacher sees it. What is seen meanwhile stays what the hand saw that was there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from .belief import Outlook
from .decisions import EARLIEST_FRAME, Episodes
from .frames import stepped
from .teacher import Teacher

if TYPE_CHECKING:
    from .modeling_obact import ObActModel

ROLLED_FRAMES = 24
"""A palm is rolled out for so long."""
LATE_SHARE = 0.5
"""Share of the palms that start anywhere before the catch; the others start with the control phase."""
RIM, SOFTNESS, FAR_M, FAR_WEIGHT = 0.9, 0.27, 0.1, 0.3
"""The loss is a smooth step at this share of the radius within which a target is caught, so wide in radii, and a part
of the distance beyond, in this unit."""


def rolled_rows(episodes: Episodes, late: int) -> Tensor:
    """Draw the frames of the decisions through which palms are rolled out, ``(B, R)``."""
    targets = episodes.targets
    assert targets is not None
    known = torch.minimum(targets.length, episodes.count)
    first = (episodes.window - late).clamp_min(EARLIEST_FRAME)
    last = torch.minimum(known - 4, torch.minimum(targets.free, targets.held) - 1) - late
    anywhere = first + (torch.rand(len(first)) * (last - first).clamp_min(0)).long()
    start = torch.where(torch.rand(len(first)) < LATE_SHARE, anywhere, first)
    start = torch.minimum(start, (known - 4 - late).clamp_min(EARLIEST_FRAME))
    rows = start[:, None] + torch.arange(ROLLED_FRAMES)
    return torch.minimum(rows, (known - 2)[:, None])


def closed_loop_loss(model: ObActModel, outlook: Outlook, episodes: Episodes, rows: Tensor, teacher: Teacher) -> Tensor:
    """Return the loss of each episode, ``(B,)``.

    Args:
        model: whose head moves the palms.
        outlook: what it believes at ``rows``.
        episodes: with targets.
        rows: ``(B, R)``.
        teacher: says how far a palm is from catching.
    """
    targets, rig, device = episodes.targets, model.config.rig, model.device
    assert targets is not None
    due = rows[:, :1] + rig.delay_frames + torch.arange(rows.shape[1] + 1)  # (B, R + 1)
    known = (due[:, :-1] < torch.minimum(targets.length, episodes.count)[:, None] - 1).to(device)
    path = targets.path[torch.arange(len(rows))[:, None], torch.minimum(due, targets.length[:, None] - 1)].to(device)
    palm = episodes.palm(due[:, :1])[:, 0].to(device)
    state = episodes.state[torch.arange(len(rows)), rows[:, 0]].to(device)
    offsets = [palm - path[:, 0]]
    for r in range(rows.shape[1]):
        palm = stepped(palm, model.act_once(outlook.at(r), palm, state)[:, :3], rig.step_m)
        offsets.append(palm - path[:, r + 1])
    misses = teacher.misses(torch.stack(offsets, dim=1))  # (B, R')
    known = known[:, : misses.shape[1]]
    least = misses.masked_fill(~known, torch.inf).amin(1)
    least = least.where(least.isfinite(), 0.0)
    step = torch.sigmoid((least / teacher.radius_m - RIM) / SOFTNESS)
    return (step + FAR_WEIGHT * (least / FAR_M).clamp_max(2.0)) * known.any(1)
