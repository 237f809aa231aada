"""To and fro on an arc, at prescribed speed (a pendulum without physics)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS, PrescribedMotion
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import Vector, as_vector


@MOTIONS.register("swinging_arc")
@dataclass(frozen=True)
class SwingingArc(PrescribedMotion):
    """r = pivot + R (h sin q - z cos q), q(t) = A sin(w t + phase): radius 0.25 to 0.6 m, swing 20 to 60 degrees.

    Attributes:
        pivot: centre of the arc [m].
        radius_m: R.
        swing_rad: A.
        rate_rad_s: w, 0.35 to 0.8 Hz with peak speed at most 1.6 m/s.
        phase_rad: phase at t = 0.
        yaw_rad: direction of h, horizontal.
    """

    pivot: Vector
    radius_m: float
    swing_rad: float
    rate_rad_s: float
    phase_rad: float
    yaw_rad: float
    name: ClassVar[str] = "swinging_arc"
    category: ClassVar[str] = "circular_arc"
    phrase: ClassVar[str] = "swinging to and fro along an arc"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw the arc and its rhythm."""
        radius, swing = draw.uniform(0.25, 0.6), np.radians(draw.uniform(20, 60))
        rate = min(2 * np.pi * draw.sample_speed(0.35, 0.8), 1.6 / (radius * swing) * draw.speed_scale)
        pivot = as_vector(np.asarray(draw.meeting_point()) + [0.0, 0.0, radius])
        return cls(pivot, radius, float(swing), float(rate), draw.angle(), draw.angle())

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        radial, _ = self._frame(time_s)
        return np.asarray(self.pivot) + self.radius_m * radial

    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s]."""
        _, tangent = self._frame(time_s)
        return self.radius_m * self._angle_rate(time_s)[:, None] * tangent

    def acceleration(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) acceleration [m/s^2]: tangential and centripetal."""
        radial, tangent = self._frame(time_s)
        angular = -(self.rate_rad_s**2) * self._angle(time_s)
        return self.radius_m * (angular[:, None] * tangent - self._angle_rate(time_s)[:, None] ** 2 * radial)

    def _angle(self, time_s: np.ndarray) -> np.ndarray:
        return self.swing_rad * np.sin(self.rate_rad_s * time_s + self.phase_rad)

    def _angle_rate(self, time_s: np.ndarray) -> np.ndarray:
        return self.swing_rad * self.rate_rad_s * np.cos(self.rate_rad_s * time_s + self.phase_rad)

    def _frame(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(K, 3) unit vectors from the pivot to the target, and along growing angle."""
        angle = self._angle(time_s)[:, None]
        along = np.array([np.cos(self.yaw_rad), np.sin(self.yaw_rad), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        return along * np.sin(angle) - up * np.cos(angle), along * np.cos(angle) + up * np.sin(angle)
