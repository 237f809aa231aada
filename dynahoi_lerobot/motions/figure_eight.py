"""A figure of eight in a vertical plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS, PrescribedMotion
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import Vector


@MOTIONS.register("figure_eight")
@dataclass(frozen=True)
class FigureEight(PrescribedMotion):
    """r = center + h A sin q + z (A / 2) sin 2 q, q = w t + phase: A 0.1 to 0.25 m, 0.15 to 0.45 Hz.

    Attributes:
        center: crossing point [m].
        amplitude_m: A.
        rate_rad_s: w.
        phase_rad: q at t = 0.
        yaw_rad: direction of h, horizontal.
    """

    center: Vector
    amplitude_m: float
    rate_rad_s: float
    phase_rad: float
    yaw_rad: float
    name: ClassVar[str] = "figure_eight"
    category: ClassVar[str] = "hybrid"
    phrase: ClassVar[str] = "tracing a figure of eight"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw size and rhythm."""
        rate = 2 * np.pi * draw.sample_speed(0.15, 0.45)
        return cls(draw.meeting_point(), draw.uniform(0.1, 0.25), float(rate), draw.angle(), draw.angle())

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        q = self._angle(time_s)
        return np.asarray(self.center) + self._plane(np.sin(q), np.sin(2 * q) / 2)

    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s]."""
        q = self._angle(time_s)
        return self.rate_rad_s * self._plane(np.cos(q), np.cos(2 * q))

    def acceleration(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) acceleration [m/s^2]."""
        q = self._angle(time_s)
        return self.rate_rad_s**2 * self._plane(-np.sin(q), -2 * np.sin(2 * q))

    def _angle(self, time_s: np.ndarray) -> np.ndarray:
        return self.rate_rad_s * time_s + self.phase_rad

    def _plane(self, along: np.ndarray, up: np.ndarray) -> np.ndarray:
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return self.amplitude_m * np.column_stack([c * along, s * along, up])
