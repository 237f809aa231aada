"""Straight line that bends into an arc, at constant speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS, PrescribedMotion
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import Vector


@MOTIONS.register("line_then_arc")
@dataclass(frozen=True)
class LineThenArc(PrescribedMotion):
    """A Dubins piece LS (Appendix "Geometric view"): speed 0.25 to 0.9 m/s, then an arc of 0.15 to 0.4 m radius.

    Attributes:
        bend: where the line meets the arc [m].
        yaw_rad: direction of the line, horizontal.
        bend_s: when the target is there [s]; within the observation window.
        speed_m_s: constant speed.
        radius_m: signed radius; positive bends to the left.
    """

    bend: Vector
    yaw_rad: float
    bend_s: float
    speed_m_s: float
    radius_m: float
    name: ClassVar[str] = "line_then_arc"
    category: ClassVar[str] = "hybrid"
    phrase: ClassVar[str] = "moving in a line that bends into an arc"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw line, bend and arc; at least the last fifth of the window shows the arc."""
        bend_s = draw.window_s * draw.uniform(0.2, 0.8)
        radius = draw.uniform(0.15, 0.4) * draw.sign()
        return cls(draw.meeting_point(), draw.angle(), bend_s, draw.sample_speed(0.25, 0.9), radius)

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        line, turn = self._split(time_s)
        along = self.speed_m_s * line + self.radius_m * np.sin(turn)
        aside = self.radius_m * (1 - np.cos(turn))
        return np.asarray(self.bend) + self._plane(along, aside)

    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s]."""
        _, turn = self._split(time_s)
        return self.speed_m_s * self._plane(np.cos(turn), np.sin(turn))

    def acceleration(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) acceleration [m/s^2]: none on the line, centripetal on the arc."""
        _, turn = self._split(time_s)
        centripetal = (time_s > self.bend_s) * self.speed_m_s**2 / self.radius_m
        return self._plane(-centripetal * np.sin(turn), centripetal * np.cos(turn))

    def _split(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Time before the bend (negative) [s] and angle turned after it [rad], (K,) each."""
        since = time_s - self.bend_s
        return np.minimum(since, 0.0), self.speed_m_s * np.maximum(since, 0.0) / self.radius_m

    def _plane(self, along: np.ndarray, aside: np.ndarray) -> np.ndarray:
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.column_stack([along * c - aside * s, along * s + aside * c, np.zeros_like(along)])
