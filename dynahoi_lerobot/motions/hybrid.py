"""Motions that combine several primitives."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.core.numerics import cos, norm, product, sin
from dynahoi_lerobot.motions.base import MOTIONS, Draw, PrescribedMotion
from dynahoi_lerobot.motions.launch import Vector, as_vector


@MOTIONS.register("figure_eight")
@dataclass(frozen=True)
class FigureEight(PrescribedMotion):
    """r = center + h A sin q + z (A / 2) sin 2 q, q = w t + phase: A 0.1 to 0.25 m, 0.15 to 0.45
    Hz.

    Attributes:
        center: crossing point [m].
        amplitude_m: A.
        rate_rad_s: w.
        phase_rad: q at t = 0.
        yaw_rad: direction of h, horizontal.
    """

    center: Vector
    amplitude_m: float
    rate_rad_s: float
    phase_rad: float
    yaw_rad: float
    category: ClassVar[str] = "hybrid"
    phrase: ClassVar[str] = "tracing a figure of eight"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw size and rhythm."""
        rate = 2 * np.pi * draw.sample_speed(0.15, 0.45)
        return cls(
            draw.meeting_point(), draw.uniform(0.1, 0.25), float(rate), draw.angle(), draw.angle()
        )

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        q = self.rate_rad_s * time_s + self.phase_rad
        along = sin(q)
        up = sin(2 * q) / 2
        shape = np.column_stack([cos(self.yaw_rad) * along, sin(self.yaw_rad) * along, up])
        return np.asarray(self.center) + self.amplitude_m * shape


@MOTIONS.register("harmonic_drift")
@dataclass(frozen=True)
class HarmonicDrift(PrescribedMotion):
    """r = meeting + u v tau + n A sin(w t + phase), n at right angles to u: drift 0.08 to 0.3 m/s,
    A 0.08 to 0.22 m.

    Attributes:
        meeting: center of the oscillation at ``meeting_s`` [m].
        drift: u v [m/s].
        across: n, unit vector.
        meeting_s: [s].
        amplitude_m: A.
        rate_rad_s: w, 0.4 to 1 Hz with peak speed at most 1.2 m/s.
        phase_rad: phase at t = 0.
    """

    meeting: Vector
    drift: Vector
    across: Vector
    meeting_s: float
    amplitude_m: float
    rate_rad_s: float
    phase_rad: float
    category: ClassVar[str] = "hybrid"
    phrase: ClassVar[str] = "oscillating while it drifts along"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw drift and oscillation."""
        speed = draw.sample_speed(0.08, 0.3)
        amplitude = draw.uniform(0.08, 0.22)
        direction = np.asarray(draw.level_heading(0.5, speed * draw.horizon_s))
        across = np.cross(direction, draw.rng.normal(size=3))
        rate = min(2 * np.pi * draw.sample_speed(0.4, 1.0), 1.2 / amplitude * draw.speed_scale)
        return cls(
            draw.meeting_point(), as_vector(speed * direction), as_vector(across / norm(across)),
            draw.intercept_s, amplitude, float(rate), draw.angle(),
        )  # fmt: skip

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        drifted = (time_s - self.meeting_s)[:, None] * np.asarray(self.drift)
        swing = sin(self.rate_rad_s * time_s + self.phase_rad)[:, None]
        return (
            np.asarray(self.meeting) + drifted + self.amplitude_m * swing * np.asarray(self.across)
        )


@MOTIONS.register("line_then_arc")
@dataclass(frozen=True)
class LineThenArc(PrescribedMotion):
    """A Dubins piece LS (Appendix "Geometric view"): speed 0.25 to 0.9 m/s, then an arc of 0.15 to
    0.4 m radius.

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
        since = time_s - self.bend_s
        turn = (
            self.speed_m_s * np.maximum(since, 0.0) / self.radius_m
        )  # angle turned after the bend [rad]
        along = self.speed_m_s * np.minimum(since, 0.0) + self.radius_m * sin(turn)
        aside = self.radius_m * (1 - cos(turn))
        c = cos(self.yaw_rad)
        s = sin(self.yaw_rad)
        level = np.column_stack(
            [along * c - aside * s, along * s + aside * c, np.zeros_like(along)]
        )
        return np.asarray(self.bend) + level


KNOT_S = 0.5
BASIS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
"""Rows: coefficients of 1, s, s^2, s^3 for the four control points around a segment, s in [0,
1)."""


@MOTIONS.register("random_spline")
@dataclass(frozen=True)
class RandomSpline(PrescribedMotion):
    """Twice continuously differentiable; control points every 0.5 s, steps of 0.15 to 0.45 m, drawn
    to their middle.

    Attributes:
        points: control points [m]; the first segment starts at t = 0.
        knot_s: time between control points [s].
    """

    points: tuple[Vector, ...]
    knot_s: float
    category: ClassVar[str] = "hybrid"
    phrase: ClassVar[str] = "wandering along a smooth random path"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw control points as a random walk with a pull back to the meeting point."""
        knot_s = KNOT_S / draw.speed_scale
        count = int(np.ceil(draw.horizon_s / knot_s)) + 4
        step = draw.uniform(0.15, 0.45)
        middle = np.asarray(draw.meeting_point())
        heading = draw.rng.normal(size=3)
        points = [middle + 0.1 * draw.rng.normal(size=3)]
        for _ in range(count - 1):
            heading = 0.6 * heading / norm(heading) + 0.6 * draw.rng.normal(size=3)
            pull = 0.25 * (middle - points[-1])
            points.append(points[-1] + pull + step * heading / norm(heading))
        return cls(tuple(as_vector(p) for p in points), knot_s)

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        points = np.asarray(self.points)
        segment = np.clip(np.floor(time_s / self.knot_s).astype(int), 0, len(points) - 4)
        s = time_s / self.knot_s - segment
        powers = np.column_stack(
            [np.ones_like(s), s, s * s, s * s * s]
        )  # (K, 4); `**` rounds by processor
        weights = product(powers, BASIS)  # (K, 4)
        return np.einsum("kw,kwd->kd", weights, points[segment[:, None] + np.arange(4)])
