"""The target's track: sightings from a moving hand, put together in one frame that does not move.

A sighting is an offset from the palm. Added to where the palm was, the sightings of many frames are points of one path;
a weighted straight line through the latest of them says where the target is, and how fast it goes, and a parabola
through more of them how it turns::

    minimise over p, v      sum_i w_i |q_i - p + v age_i|^2 + (|v| / V)^2,     w_i = exp(-age_i / A) / sigma_i^2
    minimise over p, v, c   sum_i w_i |q_i - p + v age_i - c age_i^2 / 2|^2 + (|v| / V)^2 + (|c| / C)^2
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .decisions import Decisions
from .frames import EncodedFrames

N_SIGHTING = 8
"""Numbers of a sighting: offset from the palm [m] (3), u, v and log depth in the camera frame (3), logarithmic scales
of the errors across and along the line of sight (2)."""
MEMORY_S, TYPICAL_SPEED_M_S = 0.15, 0.5
"""A and V of the line."""
LONG_MEMORY_S, FAST_M_S, TYPICAL_ACCELERATION_M_S2 = 0.3, 2.0, 5.0
"""A, V and C of the parabola."""
N_TRACK = 3 + 3 + 9 + N_SIGHTING
LENGTH_M = 0.3
"""Typical length, by which positions are divided before a network sees them."""


@dataclass(frozen=True)
class Track:
    """Where the target of each of ``R`` decisions is, relative to the palm.

    Attributes:
        offset: of the target, from the line through its sightings [m], shape ``(R, 3)``.
        velocity: of that line [m/s], shape ``(R, 3)``.
        parabola: offset [m], velocity [m/s] and acceleration [m/s^2] of the parabola, shape ``(R, 3, 3)``.
        sighting: of the current frame, shape ``(R, N_SIGHTING)``.
    """

    offset: Tensor
    velocity: Tensor
    parabola: Tensor
    sighting: Tensor

    @classmethod
    def of(cls, frames: EncodedFrames, decisions: Decisions, position: Tensor) -> Track:
        """Fit the tracks of decisions whose hands are at ``position`` (R, P), in the unit of the state."""
        places = frames.position[..., :3] + frames.sightings[..., :3]  # (B, T, 3)
        points = decisions.windows(places) - position[:, None, :3]  # (R, W, 3)
        sigma = sighting_error(decisions.windows(frames.sightings))  # (R, W)
        trust, age_s = decisions.pick(decisions.keep) / sigma.square(), decisions.age_s
        offset, velocity = fit_line(points, trust * (-age_s / MEMORY_S).exp(), age_s)
        parabola = fit_parabola(points, trust * (-age_s / LONG_MEMORY_S).exp(), age_s)
        return cls(offset, velocity, parabola, decisions.current(frames.sightings))

    def features(self) -> Tensor:
        """Return all of it in units of about one, ``(R, N_TRACK)``."""
        unit = self.parabola.new_tensor([[LENGTH_M], [TYPICAL_SPEED_M_S], [TYPICAL_ACCELERATION_M_S2]])
        line = [self.offset / LENGTH_M, self.velocity / TYPICAL_SPEED_M_S]
        return torch.cat([*line, (self.parabola / unit).flatten(1), scaled(self.sighting)], dim=-1)

    def along_line(self, ahead_s: Tensor, damping: Tensor) -> Tensor:
        """Return where the line leads at times ``(K,)`` [s], slowed down, ``(R, K, 3)``."""
        return self.offset[:, None] + self.velocity[:, None] * (ahead_s * damping)[..., None]

    def along_parabola(self, ahead_s: Tensor) -> Tensor:
        """Return where the parabola leads at times ``(K,)`` [s], ``(R, K, 3)``."""
        powers = torch.stack([torch.ones_like(ahead_s), ahead_s, ahead_s.square() / 2], dim=-1)  # (K, 3)
        return powers @ self.parabola


def sighting_error(sightings: Tensor) -> Tensor:
    """Return the expected errors across and along the line of sight together [m], ``(..., N_SIGHTING) -> (...)``."""
    distance = sightings[..., :3].norm(dim=-1) + 0.1
    scales = sightings[..., 6:8].clamp(-5.0, 5.0).exp()
    return (distance * scales.norm(dim=-1)).clamp_min(0.003)


def scaled(sightings: Tensor) -> Tensor:
    """Divide the offsets of sightings by a typical length."""
    return torch.cat([sightings[..., :3] / LENGTH_M, sightings[..., 3:]], dim=-1)


def fit_line(points: Tensor, weights: Tensor, age_s: Tensor) -> tuple[Tensor, Tensor]:
    """Return position now and velocity of a weighted straight line, ``(R, 3)`` each.

    Args:
        points: shape ``(R, W, 3)`` [m].
        weights: shape ``(R, W)`` [1/m^2], not all zero.
        age_s: of the points [s], shape ``(W,)``.
    """
    s0, s1 = weights.sum(-1, keepdim=True), -(weights * age_s).sum(-1, keepdim=True)
    s2 = (weights * age_s.square()).sum(-1, keepdim=True) + TYPICAL_SPEED_M_S**-2
    y0 = (weights[..., None] * points).sum(1)
    y1 = -((weights * age_s)[..., None] * points).sum(1)
    determinant = s0 * s2 - s1.square()
    return (s2 * y0 - s1 * y1) / determinant, (s0 * y1 - s1 * y0) / determinant


def fit_parabola(points: Tensor, weights: Tensor, age_s: Tensor) -> Tensor:
    """Return position, velocity and acceleration now of a weighted parabola, ``(R, 3, 3)``; see `fit_line`."""
    basis = torch.stack([torch.ones_like(age_s), -age_s, age_s.square() / 2], dim=-1)  # (W, 3)
    prior = weights.new_tensor([1e-6, FAST_M_S**-2, TYPICAL_ACCELERATION_M_S2**-2]).diag()
    weighted = weights[..., None] * basis  # (R, W, 3)
    return torch.linalg.solve(weighted.mT @ basis + prior, weighted.mT @ points)


class MotionEncoder(nn.Module):
    """Encodes where the target and the palm are at one frame, in a frame that does not move.

    Args:
        width: token size.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(N_SIGHTING + 6, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, sightings: Tensor, position: Tensor) -> Tensor:
        """Map sightings ``(B, T, N_SIGHTING)`` and states ``(B, T, P)`` to tokens ``(B, T, D)``."""
        palm = position[..., :3]
        return self.net(torch.cat([scaled(sightings), palm / LENGTH_M, (palm + sightings[..., :3]) / LENGTH_M], dim=-1))
