"""Circles at constant angular speed, a helix, and an arc swung to and fro."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.core.numerics import cos, product, sin
from dynahoi_lerobot.motions.base import MOTIONS, Draw, PrescribedMotion
from dynahoi_lerobot.motions.launch import Vector, as_vector


@dataclass(frozen=True)
class CircularMotion(PrescribedMotion):
    """r(t) = center + R (e1 cos w t' + e2 sin w t'), t' = t + phase / w (primitive A).

    Radius 0.1 to 0.3 m, speed 0.3 to 1 m/s, either sense.

    Attributes:
        center: center of the circle [m].
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
        """Return (2, 3), the unit vectors e1 and e2 of the plane; horizontal unless a kind says
        otherwise.
        """
        c = cos(self.yaw_rad)
        s = sin(self.yaw_rad)
        return np.array([[c, s, 0.0], [-s, c, 0.0]])

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        angle = self.rate_rad_s * time_s + self.phase_rad
        outwards = product(np.column_stack([cos(angle), sin(angle)]), self.axes())
        return np.asarray(self.center) + self.radius_m * outwards


@MOTIONS.register("horizontal_circle")
class HorizontalCircle(CircularMotion):
    """Constant angular speed about the vertical."""

    phrase: ClassVar[str] = "moving in a horizontal circle"


@MOTIONS.register("vertical_circle")
class VerticalCircle(CircularMotion):
    """Constant angular speed about a horizontal axis."""

    phrase: ClassVar[str] = "moving in a vertical circle"

    def axes(self) -> np.ndarray:
        """Return (2, 3): a horizontal unit vector and the vertical."""
        return np.array([[cos(self.yaw_rad), sin(self.yaw_rad), 0.0], [0.0, 0.0, 1.0]])


@MOTIONS.register("helix")
@dataclass(frozen=True)
class Helix(CircularMotion):
    """A horizontal circle with a steady climb, at most 0.6 m within the horizon.

    Attributes:
        climb_m_s: vertical speed, signed.
        meeting_s: when the circle's center is at ``center`` [s].
    """

    climb_m_s: float = 0.0
    meeting_s: float = 0.0
    phrase: ClassVar[str] = "moving along a helix"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw a circle and a climb."""
        radius = draw.uniform(0.1, 0.3)
        rate = draw.sample_speed(0.3, 1.0) / radius * draw.sign()
        climb = draw.uniform(0.2, 0.6) * draw.sign() / draw.horizon_s
        return cls(
            draw.meeting_point(), radius, rate, draw.angle(), draw.angle(), climb, draw.intercept_s
        )

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        rise = np.outer(time_s - self.meeting_s, [0.0, 0.0, self.climb_m_s])
        return super().position(time_s) + rise


@MOTIONS.register("swinging_arc")
@dataclass(frozen=True)
class SwingingArc(PrescribedMotion):
    """r = pivot + R (h sin q - z cos q), q(t) = A sin(w t + phase): radius 0.25 to 0.6 m, swing 20
    to 60 degrees.

    Attributes:
        pivot: center of the arc [m].
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
    category: ClassVar[str] = "circular_arc"
    phrase: ClassVar[str] = "swinging to and fro along an arc"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw the arc and its rhythm."""
        radius = draw.uniform(0.25, 0.6)
        swing = np.radians(draw.uniform(20, 60))
        rate = min(
            2 * np.pi * draw.sample_speed(0.35, 0.8), 1.6 / (radius * swing) * draw.speed_scale
        )
        pivot = as_vector(np.asarray(draw.meeting_point()) + [0.0, 0.0, radius])
        return cls(pivot, radius, float(swing), float(rate), draw.angle(), draw.angle())

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        angle = self.swing_rad * sin(self.rate_rad_s * time_s + self.phase_rad)[:, None]
        along = np.array([cos(self.yaw_rad), sin(self.yaw_rad), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        return np.asarray(self.pivot) + self.radius_m * (along * sin(angle) - up * cos(angle))
