"""The target's track: sightings from a moving hand, put together in one frame that does not move.

A sighting is an offset from the palm. Added to where the palm was, the sightings of many frames are points of one path.
Motion models are fitted to them. Where the target goes next is a mixture of what they expect, which the head learns;
how likely each is tells it which of them to believe.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor, nn

from .decisions import Decisions
from .eye import N_SIGHTING
from .fitting import fit_lines_of_sight
from .frames import EncodedFrames
from .motion_models import MODELS, paths, velocities
from .sightings import Sightings

LENGTH_M, TYPICAL_SPEED_M_S = 0.3, 0.5
"""By which positions and velocities are divided before a network sees them."""
LEAST_EVIDENCE = -30.0
N_FITS = len(MODELS)
N_TRACK = (6 + 1) * N_FITS + N_SIGHTING


@dataclass(frozen=True)
class Track:
    """Where the target of each of ``R`` decisions is, relative to the palm.

    Attributes:
        coefficients: of the path by each of `MODELS`, shape ``(R, N_FITS, 3, N_COEFFICIENTS)``.
        evidence: how likely each of them is, less the likeliest, logarithmic, shape ``(R, N_FITS)``.
        sighting: of the current frame by the first eye, shape ``(R, N_SIGHTING)``.
        floor_m: height of the floor [m], shape ``(R,)``.
    """

    coefficients: Tensor
    evidence: Tensor
    sighting: Tensor
    floor_m: Tensor

    @classmethod
    def of(cls, frames: EncodedFrames, decisions: Decisions, cameras: Tensor) -> Self:
        """Fit the tracks of decisions.

        Args:
            frames: with sightings.
            decisions: which are wanted.
            cameras: where those of the sightings were [m], in the frame of the state, shape ``(B, T, C', 3)``.
        """
        palm, n_eyes = decisions.current(frames.position)[:, :3], cameras.shape[2]
        keep = decisions.pick(decisions.keep).repeat_interleave(n_eyes, dim=1)  # (R, W C')
        seen = Sightings.of(frames, cameras).map(lambda part: decisions.windows(part).flatten(1, 2)).where(keep)
        age_s = decisions.age_s.repeat_interleave(n_eyes)
        with torch.autocast(palm.device.type, enabled=False):  # half precision would move a fit by millimetres
            coefficients, evidence = fit_lines_of_sight(seen.points - palm[:, None], seen.rays, seen.errors_m, age_s)
        evidence = (evidence - evidence.amax(1, keepdim=True)).clamp_min(LEAST_EVIDENCE)
        return cls(coefficients.to(palm), evidence.to(palm), decisions.current(frames.sightings)[:, 0], -palm[:, 2])

    def map(self, change: Callable[[Tensor], Tensor]) -> Self:
        """Return the track with every tensor changed alike: of other decisions, or on another device."""
        return type(self)(*(change(part) for part in vars(self).values()))

    def features(self) -> Tensor:
        """Return all of it in units of about one, ``(R, N_TRACK)``."""
        places, speeds = self.along(self.floor_m.new_zeros(1))[..., 0, :], velocities(self.coefficients)
        fits = torch.cat([places / LENGTH_M, speeds / TYPICAL_SPEED_M_S, self.evidence[..., None] / 5], dim=-1)
        return torch.cat([fits.clamp(-10.0, 10.0).flatten(1), scaled(self.sighting)], dim=-1)

    def along(self, ahead_s: Tensor) -> Tensor:
        """Return where each fit leads at times ``(K,)`` [s], ``(R, N_FITS, K, 3)``."""
        return paths(self.coefficients, ahead_s, self.floor_m)

    def along_line(self, ahead_s: Tensor, damping: Tensor) -> Tensor:
        """Return where the straight line leads at times ``(K,)`` [s], slowed down by ``(R, K)``, ``(R, K, 3)``."""
        line = self.coefficients[:, 0]
        return line[:, None, :, 0] + line[:, None, :, 1] * (ahead_s * damping)[..., None]


def scaled(sightings: Tensor) -> Tensor:
    """Divide the offsets of sightings by a typical length."""
    return torch.cat([sightings[..., :3] / LENGTH_M, sightings[..., 3:]], dim=-1)


class MotionEncoder(nn.Module):
    """Encodes where the target and the palm are at one frame, in a frame that does not move.

    Args:
        width: token size.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(N_SIGHTING + 6, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, sightings: Tensor, position: Tensor) -> Tensor:
        """Map sightings ``(B, T, C', N_SIGHTING)`` and states ``(B, T, 1, P)`` to tokens ``(B, T, C', D)``."""
        palm = position[..., :3].expand_as(sightings[..., :3])
        return self.net(torch.cat([scaled(sightings), palm / LENGTH_M, (palm + sightings[..., :3]) / LENGTH_M], dim=-1))
