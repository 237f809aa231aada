"""What paths are expected to do: a bank of linear models, of which a track fits each.

As in trackers of manoeuvring targets (Blom and Bar-Shalom, 1988) several models are fitted at once, and how likely each
is after all sightings tells which to believe. In every model a path is a sum of known functions of time t from now::

    x(t) = p + v t + c t^2 / 2 + a cos(w t) + b sin(w t) + d cos(2 w t) + e sin(2 w t)

A model says how large its seven coefficients typically are (almost zero for what it does without), and how far paths
stray from it. Oscillators of a few fixed rates w cover pendulums, springs, circles and arcs, which no parabola follows
for long. What swings on an arc rises and falls at 2 w. A throw is still until it is released: there t counts from then
on, with one model for each time of release, and what is seen before tells where it began.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

GRAVITY_M_S2 = 9.81
N_COEFFICIENTS = 7
RESTITUTION, RESTING_HEIGHT_M = 0.82, 0.04
"""Of a ball that bounces: rebound speed over impact speed, and how high its centre is at rest."""
NOTHING = 1e-4
"""In place of a coefficient that a model does without, in the unit of that coefficient."""


@dataclass(frozen=True)
class MotionModel:
    """What a path is expected to do.

    Attributes:
        stray_m_s2: accelerations that it leaves out: a path is that far from the model, times age^2 / 2.
        place_m: typical distance of p from the palm.
        speed_m_s: typical v.
        acceleration_m_s2: by how much c typically differs from gravity or from 0.
        falls: whether gravity acts.
        released_s: how long ago the target was let go [s]; None for one that always moved.
        rate_rad_s: w; 0 for what does not oscillate.
        amplitude_m: typical a and b.
        overtone_m: typical d and e.
    """

    stray_m_s2: float = 0.0
    place_m: float = 3.0
    speed_m_s: float = NOTHING
    acceleration_m_s2: float = NOTHING
    falls: bool = False
    released_s: float | None = None
    rate_rad_s: float = 0.0
    amplitude_m: float = NOTHING
    overtone_m: float = NOTHING

    @property
    def scales(self) -> tuple[float, ...]:
        """Typical sizes of the seven coefficients."""
        swings = (self.amplitude_m, self.amplitude_m, self.overtone_m, self.overtone_m)
        return (self.place_m, self.speed_m_s, self.acceleration_m_s2, *swings)

    def expected(self, like: Tensor) -> Tensor:
        """Return the coefficients expected before any sighting, ``(3, N_COEFFICIENTS)``."""
        coefficients = like.new_zeros(3, N_COEFFICIENTS)
        coefficients[2, 2] = -GRAVITY_M_S2 * self.falls
        return coefficients

    def basis(self, time_s: Tensor) -> Tensor:
        """Return the seven functions at times from now ``(T,)`` [s], ``(T, N_COEFFICIENTS)``."""
        if self.released_s is not None:
            time_s = (time_s + self.released_s).clamp_min(0.0)
        phase = self.rate_rad_s * time_s
        swings = (phase.cos(), phase.sin(), (2 * phase).cos(), (2 * phase).sin())
        return torch.stack([torch.ones_like(time_s), time_s, time_s.square() / 2, *swings], dim=-1)


RATES_RAD_S = tuple(1.6 * 1.24**i for i in range(10))
"""Periods from 3.9 to 0.6 s."""

RELEASES_S = (0.05, 0.1, 0.17, 0.25, 0.35, 0.47, 0.6)
"""How long ago a throw was released."""

MODELS = (
    MotionModel(stray_m_s2=1.5, speed_m_s=0.6),
    MotionModel(speed_m_s=0.8),
    MotionModel(speed_m_s=1.0, acceleration_m_s2=2.0),
    MotionModel(stray_m_s2=4.0, speed_m_s=2.0, acceleration_m_s2=6.0),
    *(MotionModel(stray_m_s2=stray, speed_m_s=2.0, falls=True) for stray in (40.0, 8.0, 1.0)),
    *(MotionModel(stray_m_s2=0.5, speed_m_s=2.0, falls=True, released_s=age) for age in RELEASES_S),
    *(
        MotionModel(place_m=0.5, speed_m_s=0.02, rate_rad_s=rate, amplitude_m=0.25, overtone_m=0.03)
        for rate in RATES_RAD_S
    ),
)
"""The first is a straight line that strays soon, which serves where nothing better is known."""


def paths(coefficients: Tensor, ahead_s: Tensor, floor_m: Tensor) -> Tensor:
    """Return where each of `MODELS` leads [m], shape ``(R, M, K, 3)``.

    Args:
        coefficients: of the models' paths, shape ``(R, M, 3, N_COEFFICIENTS)``.
        ahead_s: times from now [s], shape ``(K,)``.
        floor_m: height of the floor in the frame of the paths [m], shape ``(R,)``. What falls there bounces once.
    """
    led = _bases(ahead_s) @ coefficients.mT
    lowest = floor_m[:, None] + RESTING_HEIGHT_M  # (R, 1)
    height = (_bases(ahead_s.new_zeros(1)) @ coefficients[..., 2, :, None])[..., 0, 0]  # (R, M)
    bounced, after_s = _rebound(height - lowest, velocities(coefficients)[..., 2], ahead_s)
    falls = torch.tensor([model.falls for model in MODELS], device=led.device)[:, None]  # (M, 1)
    heights = torch.where(falls & (after_s > 0), bounced + lowest[..., None], led[..., 2])
    return torch.cat([led[..., :2], heights[..., None]], dim=-1)


def _rebound(height_m: Tensor, rise_m_s: Tensor, ahead_s: Tensor) -> tuple[Tensor, Tensor]:
    """Return heights after the next bounce [m], and how long that will have been [s], ``(..., K)`` each.

    Args:
        height_m: now, above where the target rests, shape ``(...)``.
        rise_m_s: vertical velocity now, shape ``(...)``.
        ahead_s: times from now, shape ``(K,)``.
    """
    impact_m_s = (rise_m_s.square() + 2 * GRAVITY_M_S2 * height_m.clamp_min(0.0) + 1e-9).sqrt()
    after_s = ahead_s - ((rise_m_s + impact_m_s) / GRAVITY_M_S2)[..., None]
    rising = RESTITUTION * impact_m_s[..., None] * after_s
    return (rising - GRAVITY_M_S2 * after_s.square() / 2).clamp_min(0.0), after_s


def velocities(coefficients: Tensor) -> Tensor:
    """Return the velocities now of each of `MODELS` [m/s], ``(R, M, 3, N_COEFFICIENTS) -> (R, M, 3)``."""
    rate = coefficients.new_tensor([model.rate_rad_s for model in MODELS])[:, None]
    flown_s = coefficients.new_tensor([model.released_s or 0.0 for model in MODELS])[:, None]
    swinging = rate * (coefficients[..., 4] + 2 * coefficients[..., 6])
    return coefficients[..., 1] + flown_s * coefficients[..., 2] + swinging


def _bases(time_s: Tensor) -> Tensor:
    return torch.stack([model.basis(time_s) for model in MODELS])  # (M, K, N_COEFFICIENTS)
