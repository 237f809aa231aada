"""What the teacher answers for palms that were never there: training only, the acting code does not import this.

A recorded episode shows one hand on its way to one target. The belief about the target does not depend on where the
palm is, so each decision is taken from several palms at once: where the palm was, moved from there, and near the
teacher's own way. For each the teacher's answer has a closed form: the earliest point of the target's path that a palm
of limited speed reaches with a little time to spare, and fingers that close by the time left until then.
"""

from dataclasses import dataclass

import torch
from einops import rearrange, repeat
from torch import Tensor

LONGEST_FRAMES = 100
"""The teacher looks this far ahead."""
CLOSED_FRAMES, CLOSING_FRAMES = 24, 8
"""Fingers are closed this long before the meeting, and take this long to close."""
NEAREST_M, FARTHEST_M = 0.01, 0.15
"""Least and greatest standard deviation by which a virtual palm is moved, along each axis."""
UNREACHABLE_WEIGHT = 0.1
PLANNED_SPEED = 0.85
"""Share of the palm's speed limit that the teacher plans with where that suffices: a palm that needs all of it comes
too late whenever the forecast was wrong."""
SLACK_M = 0.015
"""Within this distance the palm has met the target: half of the localisation radius. Without it, a hand that trails a
slightly faster target heads for a distant meeting instead of closing the last centimetres."""


@dataclass(frozen=True)
class Answers:
    """What the teacher would do, for palms ``(B, Q, M, ...)``.

    Attributes:
        palm: where the palm is when the command takes effect [m].
        meeting: where it goes [m].
        frames: until it is there.
        reachable: whether it can be there in time, bool.
    """

    palm: Tensor
    meeting: Tensor
    frames: Tensor
    reachable: Tensor

    @property
    def weight(self) -> Tensor:
        """Weight in the loss."""
        return torch.where(self.reachable, 1.0, UNREACHABLE_WEIGHT)

    def closing(self, ahead: int) -> Tensor:
        """Return how far the fingers should be closed after 0, 1, ... ``ahead`` - 1 frames, 0 open, 1 closed."""
        left = self.frames[..., None] - torch.arange(ahead, device=self.frames.device)
        return ((CLOSED_FRAMES + CLOSING_FRAMES - left) / CLOSING_FRAMES).clamp(0, 1)


def answers(path: Tensor, length: Tensor, due: Tensor, palms: Tensor, step_m: float) -> Answers:
    """Return where the teacher meets the target: at the earliest point in reach, or where it misses by least.

    Args:
        path: of the untouched target [m], ``(B, F, 3)``.
        length: frames of it that are known, ``(B,)``.
        due: the frame at which the command takes effect, ``(B, Q)``.
        palms: where palms are then [m], ``(B, Q, M, 3)``.
        step_m: how far a palm gets in a frame [m].
    """
    q, m = palms.shape[1:3]
    ahead = torch.arange(1, LONGEST_FRAMES + 1, device=path.device)
    last = length[:, None, None] - 1
    frame = due[..., None] + ahead  # (B, Q, K)
    index = repeat(torch.minimum(frame, last), "b q k -> b (q k) i", i=3)
    future = rearrange(path.gather(1, index), "b (q k) i -> b q 1 k i", q=q)
    distance, known = (future - palms[:, :, :, None]).norm(dim=-1), (frame <= last)[:, :, None]  # (B, Q, M, K)
    late = (distance - step_m * ahead).masked_fill(~known, float("inf"))  # what the palm is short of [m]
    possible, planned = late <= SLACK_M, known & (distance - PLANNED_SPEED * step_m * ahead <= SLACK_M)
    reachable = possible.any(-1)
    possible = torch.where(planned.any(-1, keepdim=True), planned, possible)
    frames = torch.where(reachable, possible.int().argmax(-1), late.argmin(-1)) + 1
    chosen = repeat(frames - 1, "b q m -> b q m 1 i", i=3)
    meeting = future.expand(-1, -1, m, -1, -1).gather(3, chosen)[:, :, :, 0]
    return Answers(palms, meeting, frames, reachable)


def virtual_palms(path: Tensor, length: Tensor, window: Tensor, due: Tensor, *, palm: Tensor, step_m: float) -> Tensor:
    """Draw four palms for each decision, ``(B, Q, 4, 3)`` [m]; the first is where the palm was.

    Args:
        path, length: see `answers`.
        window: frames of the observation window, ``(B,)``.
        due: the frame at which the command takes effect, ``(B, Q)``.
        palm: where the palm was then [m], ``(B, Q, 3)``.
        step_m: how far a palm gets in a frame [m].
    """
    start = torch.minimum(window, length - 2)[:, None]
    home = path.new_zeros(len(path), 1, 1, 3)
    first = answers(path, length, start, home, step_m).meeting[:, 0]  # (B, 1, 3)
    gone = (due - start).clamp_min(0) * step_m / first.norm(dim=-1).clamp_min(0.02)
    on_its_way = gone.clamp_max(1.0)[..., None] * first
    base = torch.stack([palm, palm, on_its_way, on_its_way], dim=2)
    spread = NEAREST_M * (FARTHEST_M / NEAREST_M) ** torch.rand(*base.shape[:3], 1, device=base.device)
    moved = torch.randn_like(base) * spread
    moved[:, :, 0] = 0.0
    return base + moved
