"""Simple harmonic motion along one axis."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.core.numerics import sin
from dynahoi_lerobot.motions.base import MOTIONS, Draw, PrescribedMotion
from dynahoi_lerobot.motions.launch import Vector

MAX_PEAK_SPEED_M_S = 1.5


@dataclass(frozen=True)
class HarmonicMotion(PrescribedMotion):
    """r(t) = center + axis A sin(2 pi f t + phase) (primitive H).

    Amplitude 0.1 to 0.35 m, frequency 0.35 to 1 Hz, peak speed at most 1.5 m/s.

    Attributes:
        center: equilibrium [m].
        amplitude_m: A.
        frequency_hz: f.
        phase_rad: phase at t = 0.

    Class attributes:
        axis: unit vector of the oscillation, world.
    """

    center: Vector
    amplitude_m: float
    frequency_hz: float
    phase_rad: float
    category: ClassVar[str] = "simple_harmonic"
    axis: ClassVar[Vector]

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw amplitude, frequency and phase."""
        amplitude = draw.uniform(0.1, 0.35)
        fastest = MAX_PEAK_SPEED_M_S / (2 * np.pi * amplitude)
        frequency = min(draw.sample_speed(0.35, 1.0), fastest * draw.speed_scale)
        return cls(draw.meeting_point(), amplitude, frequency, draw.angle())

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        rate_rad_s = 2 * np.pi * self.frequency_hz
        swing = sin(rate_rad_s * time_s + self.phase_rad)[:, None]
        return np.asarray(self.center) + self.amplitude_m * swing * np.asarray(self.axis)


@MOTIONS.register("lateral")
class Lateral(HarmonicMotion):
    """Harmonic along y, across the view."""

    phrase: ClassVar[str] = "oscillating from side to side"
    axis: ClassVar[Vector] = (0.0, 1.0, 0.0)


@MOTIONS.register("depth")
class Depth(HarmonicMotion):
    """Harmonic along x, the direction that the palm faces."""

    phrase: ClassVar[str] = "oscillating towards and away from the hand"
    axis: ClassVar[Vector] = (1.0, 0.0, 0.0)


@MOTIONS.register("vertical")
class Vertical(HarmonicMotion):
    """Harmonic along z."""

    phrase: ClassVar[str] = "oscillating up and down"
    axis: ClassVar[Vector] = (0.0, 0.0, 1.0)
