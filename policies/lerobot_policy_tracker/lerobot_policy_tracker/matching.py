"""How a hand arrives at the target's own velocity: what nothing attaches would bounce off a hand that comes fast.

The palm is where the target is after K frames, p, at the target's velocity there and a closing speed more along the
palm's normal, v; on its way it is accelerated evenly::

    palm(k) = p - v (K - k) + (v K - p) ((K - k) / K)^2,    palm(0) = 0

What is left of a parabola is a parabola, so a hand that plans anew in every frame goes on as planned. As the scripted
catch of the benchmark does (`dynahoi_lerobot.experts.match`), it prefers to meet a target where that is slow, soon, and
within its limits; the scripted one looks for such a moment once, with the path known.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .reach import Reach

CLOSING_SPEED_M_S = 0.3
"""Relative to the target's velocity, along the palm's normal, +x."""
COST_OF_EXCESS, COST_OF_SPEED, COST_OF_A_FRAME = 100.0, 1.0, 0.1
"""Of a palm twice as fast as it may be, of a target at 1 m/s, and of meeting it a frame later."""


def matched_path(path: Tensor, reach: Reach, fps: float) -> Tensor:
    """Return where palms will be, from frame 0 on, relative to their start [m], ``(B, F + 1, 3)``.

    Args:
        path: expected offsets of the targets from the hands' start [m], shape ``(B, F + 1, 3)`` for frames 0 to F.
        reach: the hand.
        fps: frames in a second.
    """
    meetings = torch.arange(1, path.shape[1], device=path.device)  # (F,), K
    steps = torch.gradient(path, dim=1)[0][:, 1:]  # (B, F, 3)
    arriving = steps + path.new_tensor([CLOSING_SPEED_M_S / fps, 0.0, 0.0])
    palms = _approaches(path, arriving, meetings)  # (B, F, F + 1, 3)
    before = meetings <= meetings[:, None]
    excess = (palms.diff(dim=2).norm(dim=-1) * before / reach.palm_step_m - 1).clamp_min(0.0).amax(-1)  # (B, F)
    speed = fps * steps.norm(dim=-1)
    cost = COST_OF_EXCESS * excess + COST_OF_SPEED * speed + COST_OF_A_FRAME * meetings
    return palms[torch.arange(len(path)), cost.argmin(1)]


def _approaches(path: Tensor, arriving: Tensor, meetings: Tensor) -> Tensor:
    """Return the palms' ways to meetings after K (F,) frames each, and the target's from there on.

    Args:
        path: see `matched_path`.
        arriving: steps with which palms arrive there [m a frame], shape ``(B, F, 3)``.
        meetings: K, shape ``(F,)``.
    """
    frames = torch.arange(path.shape[1], device=path.device)
    left = (meetings[:, None] - frames)[..., None]  # (F, F + 1, 1)
    met, arriving, whole = path[:, 1:, None], arriving[:, :, None], meetings[:, None, None]
    way = met - arriving * left + (arriving * whole - met) * (left / whole).square()
    return torch.where(left > 0, way, path[:, None])
