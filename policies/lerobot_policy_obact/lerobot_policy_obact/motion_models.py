"""What paths are expected to do for a while, and how sightings are fitted to that.

As in trackers of manoeuvring targets (Blom and Bar-Shalom, 1988) several models are fitted at once, each with its own
memory A and what it expects of speed and acceleration::

    minimise over p, v, c   sum_i w_i |q_i - p + v age_i - c age_i^2 / 2|^2 + |v / V|^2 + |(c - g) / C|^2,
    w_i = exp(-age_i / A) / sigma_i^2,      g: gravity for a model that falls, 0 for the others
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

GRAVITY_M_S2 = 9.81
FARTHEST_M = 1e3
"""So much as nothing is expected of the position."""
STEADY_M_S2 = 1e-3
"""C of a model that knows the acceleration."""


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


def remembered(age_s: Tensor) -> Tensor:
    """Return how much of sightings of ages ``(W,)`` [s] each model remembers, ``(M, W)``."""
    memory_s = age_s.new_tensor([model.memory_s for model in MODELS])[:, None]
    return (-age_s / memory_s).exp()


def powers(age_s: Tensor) -> Tensor:
    """Return the shares of position, velocity and acceleration now in where targets were, ``(W,) -> (W, 3)``."""
    return torch.stack([torch.ones_like(age_s), -age_s, age_s.square() / 2], dim=-1)


def priors(like: Tensor) -> tuple[Tensor, Tensor]:
    """Return what models expect of motions ``(M, 3, 3)``, and the inverse squares of typical differences ``(M, 3)``."""
    expected = like.new_zeros(len(MODELS), 3, 3)
    expected[:, 2, 2] = like.new_tensor([-GRAVITY_M_S2 * model.falls for model in MODELS])
    scales = [(FARTHEST_M, model.speed_m_s, model.acceleration_m_s2) for model in MODELS]
    return expected, like.new_tensor(scales).square().reciprocal()


def fit_places(points: Tensor, trust: Tensor, age_s: Tensor) -> tuple[Tensor, Tensor]:
    """Fit `MODELS` to places: motion now, that is position, velocity and acceleration, ``(R, M, 3, 3)``, and misfit.

    Args:
        points: shape ``(R, W, 3)`` [m].
        trust: inverse squares of their errors, shape ``(R, W)`` [1/m^2], not all zero.
        age_s: of the points [s], shape ``(W,)``.

    Returns:
        The motions, and by how many expected errors the points are off, root mean square, shape ``(R, M)``.
    """
    fade, basis = remembered(age_s), powers(age_s)
    expected, prior = priors(points)
    weights = trust[:, None] * fade  # (R, M, W)
    weighted = (weights[..., None] * basis).mT  # (R, M, 3, W)
    normal = weighted @ basis + prior.diag_embed()
    motion = torch.linalg.solve(normal, weighted @ points[:, None] + prior[..., None] * expected)
    off = (points[:, None] - basis @ motion).square().sum(-1)  # (R, M, W)
    return motion, misfit((weights * off).sum(-1), fade, trust > 0)


def misfit(squares: Tensor, fade: Tensor, seen: Tensor) -> Tensor:
    """Return the root mean squares of sums ``(R, M)`` over sightings that count ``fade`` (M, W) if ``seen`` (R, W)."""
    n_seen = (fade * seen[:, None]).sum(-1).clamp_min(1e-6)
    return (squares / n_seen + 1e-8).sqrt()
