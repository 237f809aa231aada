"""Base class of motions on a circle at constant angular speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.foundation.products import product
from dynahoi_lerobot.motions.base import PrescribedMotion
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import Vector


@dataclass(frozen=True)
class CircularMotion(PrescribedMotion):
    """r(t) = center + R (e1 cos w t' + e2 sin w t'), t' = t + phase / w (primitive A).

    Radius 0.1 to 0.3 m, speed 0.3 to 1 m/s, either sense.

    Attributes:
        center: centre of the circle [m].
        radius_m: R.
        rate_rad_s: w, signed.
        phase_rad: angle at t = 0.
        yaw_rad: turn of the plane about the vertical.
    """

    center: Vector
    radius_m: float
    rate_rad_s: float
    phase_rad: float
    yaw_rad: float
    category: ClassVar[str] = "circular_arc"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw radius, speed, sense, phase and plane."""
        radius = draw.uniform(0.1, 0.3)
        rate = draw.sample_speed(0.3, 1.0) / radius * draw.sign()
        return cls(draw.meeting_point(), radius, rate, draw.angle(), draw.angle())

    def axes(self) -> np.ndarray:
        """Return (2, 3), the unit vectors e1 and e2 of the plane; horizontal unless a kind says otherwise."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([[c, s, 0.0], [-s, c, 0.0]])

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        return np.asarray(self.center) + self.radius_m * self._orbit(time_s, 0.0)

    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s]."""
        return self.radius_m * self.rate_rad_s * self._orbit(time_s, np.pi / 2)

    def acceleration(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) acceleration [m/s^2]."""
        return self.radius_m * self.rate_rad_s**2 * self._orbit(time_s, np.pi)

    def _orbit(self, time_s: np.ndarray, ahead: float) -> np.ndarray:
        """(K, 3) unit vector from the centre, ``ahead`` [rad] of the target; a derivative is a quarter turn ahead."""
        angle = self.rate_rad_s * time_s + self.phase_rad + ahead
        return product(np.column_stack([np.cos(angle), np.sin(angle)]), self.axes())
