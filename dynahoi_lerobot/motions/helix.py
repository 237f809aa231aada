"""A helix, a circle that rises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.circle import CircularMotion
from dynahoi_lerobot.motions.draw import Draw


@MOTIONS.register("helix")
@dataclass(frozen=True)
class Helix(CircularMotion):
    """A horizontal circle with a steady climb, at most 0.6 m within the horizon.

    Attributes:
        climb_m_s: vertical speed, signed.
        meeting_s: when the circle's centre is at ``center`` [s].
    """

    climb_m_s: float = 0.0
    meeting_s: float = 0.0
    name: ClassVar[str] = "helix"
    phrase: ClassVar[str] = "moving along a helix"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw a circle and a climb."""
        radius = draw.uniform(0.1, 0.3)
        rate = draw.sample_speed(0.3, 1.0) / radius * draw.sign()
        climb = draw.uniform(0.2, 0.6) * draw.sign() / draw.horizon_s
        return cls(draw.meeting_point(), radius, rate, draw.angle(), draw.angle(), climb, draw.intercept_s)

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        rise = np.outer(time_s - self.meeting_s, [0.0, 0.0, self.climb_m_s])
        return super().position(time_s) + rise

    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s]."""
        return super().velocity(time_s) + [0.0, 0.0, self.climb_m_s]
