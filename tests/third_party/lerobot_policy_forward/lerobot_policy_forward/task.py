"""A motion, which is a task of LeRobot's environment, and a metric."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.metrics import metric
from dynahoi_lerobot.motions.base import MOTIONS, Draw, PrescribedMotion


@MOTIONS.register("a_drift")
@dataclass(frozen=True)
class Drift(PrescribedMotion):
    """Slow uniform motion along y: at ``center`` [m, world] at ``center_s`` [s]."""

    center: tuple[float, float, float]
    center_s: float
    speed_m_s: float
    category: ClassVar[str] = "straight_line"
    phrase: ClassVar[str] = "drifting to the side"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        return cls(draw.meeting_point(), draw.intercept_s, draw.uniform(0.05, 0.2) * draw.sign())

    def position(self, time_s: np.ndarray) -> np.ndarray:
        offset = np.outer(time_s - self.center_s, [0.0, self.speed_m_s, 0.0])
        return np.asarray(self.center) + offset


@metric("E_near", unit="u", direction="lower", aggregation="mean", bounds=(0.0, 100.0))
def nearest(episode: Episode) -> float:
    """Least distance of the palm from the target [0.1 m]."""
    return float(episode.palm_distance_m.min()) / 0.1
