"""A smooth random path: a uniform cubic B-spline through seeded control points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.foundation.products import norm, product
from dynahoi_lerobot.motions.base import MOTIONS, PrescribedMotion
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import Vector, as_vector

KNOT_S = 0.5
BASIS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
"""Rows: coefficients of 1, s, s^2, s^3 for the four control points around a segment, s in [0, 1)."""


@MOTIONS.register("random_spline")
@dataclass(frozen=True)
class RandomSpline(PrescribedMotion):
    """Twice continuously differentiable; control points every 0.5 s, steps of 0.15 to 0.45 m, drawn to their middle.

    Attributes:
        points: control points [m]; the first segment starts at t = 0.
        knot_s: time between control points [s].
    """

    points: tuple[Vector, ...]
    knot_s: float
    name: ClassVar[str] = "random_spline"
    category: ClassVar[str] = "hybrid"
    phrase: ClassVar[str] = "wandering along a smooth random path"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw control points as a random walk with a pull back to the meeting point."""
        knot_s = KNOT_S / draw.speed_scale
        count = int(np.ceil(draw.horizon_s / knot_s)) + 4
        step = draw.uniform(0.15, 0.45)
        middle, heading = np.asarray(draw.meeting_point()), draw.rng.normal(size=3)
        points = [middle + 0.1 * draw.rng.normal(size=3)]
        for _ in range(count - 1):
            heading = 0.6 * heading / norm(heading) + 0.6 * draw.rng.normal(size=3)
            pull = 0.25 * (middle - points[-1])
            points.append(points[-1] + pull + step * heading / norm(heading))
        return cls(tuple(as_vector(p) for p in points), knot_s)

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        return self._evaluate(time_s, 0)

    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s]."""
        return self._evaluate(time_s, 1) / self.knot_s

    def acceleration(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) acceleration [m/s^2]."""
        return self._evaluate(time_s, 2) / self.knot_s**2

    def _evaluate(self, time_s: np.ndarray, order: int) -> np.ndarray:
        """(K, 3) the ``order``-th derivative with respect to the segment's parameter s."""
        points = np.asarray(self.points)
        segment = np.clip(np.floor(time_s / self.knot_s).astype(int), 0, len(points) - 4)
        s = time_s / self.knot_s - segment
        powers = [np.zeros_like(s)] * order + [_falling(k, order) * s ** (k - order) for k in range(order, 4)]
        weights = product(np.column_stack(powers), BASIS)  # (K, 4)
        return np.einsum("kw,kwd->kd", weights, points[segment[:, None] + np.arange(4)])


def _falling(power: int, order: int) -> float:
    """power (power - 1) ... over ``order`` factors."""
    return float(np.prod(np.arange(power, power - order, -1))) if order else 1.0
