"""Straight lines at constant acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS, Draw, PrescribedMotion
from dynahoi_lerobot.motions.launch import Vector

RISE_M = 0.7
"""Greatest change of height of a straight path within its horizon [m]."""


@dataclass(frozen=True)
class StraightMotion(PrescribedMotion):
    """r(t) = meeting + u (v tau + a tau^2 / 2), tau = t - meeting_s (primitive L, Appendix "Kinematic Primitive").

    Attributes:
        meeting: position at ``meeting_s`` [m].
        direction: unit vector u.
        meeting_s: time at which the path passes ``meeting`` [s].
        speed_m_s: speed v at that time.
        acceleration_m_s2: acceleration a along u.
    """

    meeting: Vector
    direction: Vector
    meeting_s: float
    speed_m_s: float
    acceleration_m_s2: float
    category: ClassVar[str] = "straight_line"

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        tau = time_s - self.meeting_s
        return np.asarray(self.meeting) + self._along(self.speed_m_s * tau + self.acceleration_m_s2 * tau**2 / 2)

    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s]."""
        return self._along(self.speed_m_s + self.acceleration_m_s2 * (time_s - self.meeting_s))

    def acceleration(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) acceleration [m/s^2]."""
        return self._along(np.full_like(time_s, self.acceleration_m_s2))

    @classmethod
    def between(
        cls,
        meeting: Vector,
        direction: Vector,
        meeting_s: float,
        speeds: tuple[float, float],
        over_s: float,
    ) -> Self:
        """Return the line whose speed [m/s] changes evenly from ``speeds[0]`` at 0 s to ``speeds[1]`` at ``over_s``."""
        acceleration = (speeds[1] - speeds[0]) / over_s
        return cls(meeting, direction, meeting_s, speeds[0] + acceleration * meeting_s, acceleration)

    def _along(self, amount: np.ndarray) -> np.ndarray:
        return amount[:, None] * np.asarray(self.direction)


@MOTIONS.register("constant")
@dataclass(frozen=True)
class Constant(StraightMotion):
    """Constant speed of 0.2 to 0.9 m/s."""

    name: ClassVar[str] = "constant"
    phrase: ClassVar[str] = "moving in a straight line at constant speed"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw a speed and a direction that stays off the floor."""
        speed = draw.sample_speed(0.2, 0.9)
        direction = draw.level_heading(RISE_M, speed * draw.horizon_s)
        return cls(draw.meeting_point(), direction, draw.intercept_s, speed, 0.0)


@MOTIONS.register("accelerating")
@dataclass(frozen=True)
class Accelerating(StraightMotion):
    """Speed rises linearly from 0.03 to 0.15 m/s at the start to 0.6 to 1.4 m/s at the horizon."""

    name: ClassVar[str] = "accelerating"
    phrase: ClassVar[str] = "moving in a straight line and speeding up"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw the two speeds and a direction that stays off the floor."""
        speeds = (draw.sample_speed(0.03, 0.15), draw.sample_speed(0.6, 1.4))
        direction = draw.level_heading(RISE_M, sum(speeds) / 2 * draw.horizon_s)
        return cls.between(draw.meeting_point(), direction, draw.intercept_s, speeds, draw.horizon_s)


@MOTIONS.register("decelerating")
@dataclass(frozen=True)
class Decelerating(StraightMotion):
    """Speed falls linearly from 0.6 to 1.4 m/s at the start to 0.03 to 0.12 m/s at the horizon."""

    name: ClassVar[str] = "decelerating"
    phrase: ClassVar[str] = "moving in a straight line and slowing down"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw the two speeds and a direction that stays off the floor."""
        speeds = (draw.sample_speed(0.6, 1.4), draw.sample_speed(0.03, 0.12))
        direction = draw.level_heading(RISE_M, sum(speeds) / 2 * draw.horizon_s)
        return cls.between(draw.meeting_point(), direction, draw.intercept_s, speeds, draw.horizon_s)
