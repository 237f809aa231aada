"""A motion of somebody else, under a name that sorts before all of the core's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions import MOTIONS, Draw, PrescribedMotion
from dynahoi_lerobot.motions.launch import Vector


@MOTIONS.register("a_drift")
@dataclass(frozen=True)
class Drift(PrescribedMotion):
    """Slow uniform motion along y.

    Attributes:
        center: where it is at ``center_s`` [m].
        center_s: [s].
        speed_m_s: along y.
    """

    center: Vector
    center_s: float
    speed_m_s: float
    category: ClassVar[str] = "straight_line"
    phrase: ClassVar[str] = "drifting to the side"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw where and how fast."""
        return cls(draw.meeting_point(), draw.intercept_s, draw.uniform(0.05, 0.2) * draw.sign())

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m], world."""
        return np.asarray(self.center) + np.outer(time_s - self.center_s, [0.0, self.speed_m_s, 0.0])
