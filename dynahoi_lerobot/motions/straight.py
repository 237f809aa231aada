"""Base class of motions along a straight line at constant acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import PrescribedMotion
from dynahoi_lerobot.motions.geometry import Vector

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
