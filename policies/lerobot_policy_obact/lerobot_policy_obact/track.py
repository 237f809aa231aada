"""The target's track: sightings from a moving hand, put together in one frame that does not move.

A sighting is an offset from the palm. Added to where the palm was, the sightings of many frames are points of one path.
Several motion models are fitted to the latest of them, each with its own memory A and what it expects of speed and
acceleration, as trackers of manoeuvring targets do (Blom and Bar-Shalom, 1988)::

    minimise over p, v, c   sum_i w_i |q_i - p + v age_i - c age_i^2 / 2|^2 + |v / V|^2 + |(c - g) / C|^2,
    w_i = exp(-age_i / A) / sigma_i^2,      g: gravity for a model that falls, 0 for the others

Where the target goes next is a mixture of what they expect, which the head learns; how badly each fits tells it which
of them to believe.
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
GRAVITY_M_S2 = 9.81
FARTHEST_M = 1e3
"""So much as nothing is expected of the position."""
STEADY_M_S2 = 1e-3
"""C of a model that knows the acceleration."""
LENGTH_M, TYPICAL_SPEED_M_S, TYPICAL_ACCELERATION_M_S2 = 0.3, 0.5, 5.0
"""By which positions, velocities and accelerations are divided before a network sees them."""


@dataclass(frozen=True)
class MotionModel:
    """What a path is expected to do for a while.

    Attributes:
        memory_s: A, how fast sightings are forgotten [s].
        speed_m_s: V, a typical speed [m/s].
        acceleration_m_s2: C, by how much the acceleration typically differs from that of gravity or from 0 [m/s^2].
        falls: whether gravity acts.
    """

    memory_s: float
    speed_m_s: float
    acceleration_m_s2: float = STEADY_M_S2
    falls: bool = False


MODELS = (
    MotionModel(memory_s=0.15, speed_m_s=0.5),
    MotionModel(memory_s=0.3, speed_m_s=2.0, acceleration_m_s2=5.0),
    MotionModel(memory_s=0.1, speed_m_s=3.0, falls=True),
    MotionModel(memory_s=0.4, speed_m_s=3.0, falls=True),
)
"""The first is a straight line, which serves where nothing better is known."""
N_TRACK = (9 + 1) * len(MODELS) + N_SIGHTING


@dataclass(frozen=True)
class Track:
    """Where the target of each of ``R`` decisions is, relative to the palm.

    Attributes:
        motion: position [m], velocity [m/s] and acceleration [m/s^2] now, by each of `MODELS`, shape ``(R, M, 3, 3)``.
        misfit: of each model, in units of the expected errors of the sightings, shape ``(R, M)``.
        sighting: of the current frame, shape ``(R, N_SIGHTING)``.
    """

    motion: Tensor
    misfit: Tensor
    sighting: Tensor

    @classmethod
    def of(cls, frames: EncodedFrames, decisions: Decisions, position: Tensor) -> Track:
        """Fit the tracks of decisions whose hands are at ``position`` (R, P), in the unit of the state."""
        places = frames.position[..., :3] + frames.sightings[..., :3]  # (B, T, 3)
        points = decisions.windows(places) - position[:, None, :3]  # (R, W, 3)
        sigma = sighting_error(decisions.windows(frames.sightings))  # (R, W)
        trust = decisions.pick(decisions.keep) / sigma.square()
        motion, misfit = fit_models(points, trust, decisions.age_s)
        return cls(motion, misfit, decisions.current(frames.sightings))

    def features(self) -> Tensor:
        """Return all of it in units of about one, ``(R, N_TRACK)``."""
        unit = self.motion.new_tensor([[LENGTH_M], [TYPICAL_SPEED_M_S], [TYPICAL_ACCELERATION_M_S2]])
        return torch.cat([(self.motion / unit).flatten(1), self.misfit.log1p(), scaled(self.sighting)], dim=-1)

    def along(self, ahead_s: Tensor) -> Tensor:
        """Return where each model leads at times ``(K,)`` [s], ``(R, M, K, 3)``."""
        powers = torch.stack([torch.ones_like(ahead_s), ahead_s, ahead_s.square() / 2], dim=-1)  # (K, 3)
        return powers @ self.motion

    def along_line(self, ahead_s: Tensor, damping: Tensor) -> Tensor:
        """Return where the straight line leads at times ``(K,)`` [s], slowed down by ``(R, K)``, ``(R, K, 3)``."""
        position, velocity = self.motion[:, 0, None, 0], self.motion[:, 0, None, 1]
        return position + velocity * (ahead_s * damping)[..., None]


def sighting_error(sightings: Tensor) -> Tensor:
    """Return the expected errors across and along the line of sight together [m], ``(..., N_SIGHTING) -> (...)``."""
    distance = sightings[..., :3].norm(dim=-1) + 0.1
    scales = sightings[..., 6:8].clamp(-5.0, 5.0).exp()
    return (distance * scales.norm(dim=-1)).clamp_min(0.003)


def scaled(sightings: Tensor) -> Tensor:
    """Divide the offsets of sightings by a typical length."""
    return torch.cat([sightings[..., :3] / LENGTH_M, sightings[..., 3:]], dim=-1)


def fit_models(points: Tensor, trust: Tensor, age_s: Tensor) -> tuple[Tensor, Tensor]:
    """Return what each of `MODELS` makes of points: motion now ``(R, M, 3, 3)`` and misfit ``(R, M)``, see `Track`.

    Args:
        points: shape ``(R, W, 3)`` [m].
        trust: inverse squares of their errors, shape ``(R, W)`` [1/m^2], not all zero.
        age_s: of the points [s], shape ``(W,)``.
    """
    memory_s = points.new_tensor([model.memory_s for model in MODELS])[:, None]
    scales = [(FARTHEST_M, model.speed_m_s, model.acceleration_m_s2) for model in MODELS]
    prior = points.new_tensor(scales).square().reciprocal()[..., None]  # (M, 3, 1)
    expected = points.new_zeros(len(MODELS), 3, 3)
    expected[:, 2, 2] = points.new_tensor([-GRAVITY_M_S2 * model.falls for model in MODELS])
    fade = (-age_s / memory_s).exp()  # (M, W)
    weights = trust[:, None] * fade  # (R, M, W)
    basis = torch.stack([torch.ones_like(age_s), -age_s, age_s.square() / 2], dim=-1)  # (W, 3)
    weighted = (weights[..., None] * basis).mT  # (R, M, 3, W)
    normal = weighted @ basis + prior * torch.eye(3, device=points.device)
    motion = torch.linalg.solve(normal, weighted @ points[:, None] + prior * expected)
    off = (points[:, None] - basis @ motion).square().sum(-1)  # (R, M, W)
    seen = (fade * (trust > 0)[:, None]).sum(-1).clamp_min(1e-6)
    return motion, ((weights * off).sum(-1) / seen + 1e-8).sqrt()


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
