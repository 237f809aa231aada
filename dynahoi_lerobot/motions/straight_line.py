"""Straight lines at constant acceleration."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS, Draw, PrescribedMotion
from dynahoi_lerobot.motions.launch import Vector

RISE_M = 0.7
"""Greatest change of height of a straight path within its horizon [m]."""


@dataclass(frozen=True)
class StraightMotion(PrescribedMotion):
    """r(t) = meeting + u (v tau + a tau^2 / 2), tau = t - meeting_s (primitive L, Appendix
    "Kinematic Primitive").

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
        traveled = self.speed_m_s * tau + self.acceleration_m_s2 * tau**2 / 2
        return np.asarray(self.meeting) + traveled[:, None] * np.asarray(self.direction)

    @classmethod
    def between(cls, draw: Draw, speeds: tuple[float, float]) -> Self:
        """Return a line off the floor; its speed [m/s] changes evenly from the first to the second,
        at the horizon.
        """
        direction = draw.level_heading(RISE_M, sum(speeds) / 2 * draw.horizon_s)
        acceleration = (speeds[1] - speeds[0]) / draw.horizon_s
        speed = speeds[0] + acceleration * draw.intercept_s
        return cls(draw.meeting_point(), direction, draw.intercept_s, speed, acceleration)


@MOTIONS.register("constant")
class Constant(StraightMotion):
    """Constant speed of 0.2 to 0.9 m/s."""

    phrase: ClassVar[str] = "moving in a straight line at constant speed"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw a speed and a direction that stays off the floor."""
        speed = draw.sample_speed(0.2, 0.9)
        return cls.between(draw, (speed, speed))


@MOTIONS.register("accelerating")
class Accelerating(StraightMotion):
    """Speed rises linearly from 0.03 to 0.15 m/s at the start to 0.6 to 1.4 m/s at the horizon."""

    phrase: ClassVar[str] = "moving in a straight line and speeding up"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw the two speeds."""
        return cls.between(draw, (draw.sample_speed(0.03, 0.15), draw.sample_speed(0.6, 1.4)))


@MOTIONS.register("decelerating")
class Decelerating(StraightMotion):
    """Speed falls linearly from 0.6 to 1.4 m/s at the start to 0.03 to 0.12 m/s at the horizon."""

    phrase: ClassVar[str] = "moving in a straight line and slowing down"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw the two speeds."""
        return cls.between(draw, (draw.sample_speed(0.6, 1.4), draw.sample_speed(0.03, 0.12)))
