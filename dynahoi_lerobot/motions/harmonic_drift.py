"""Oscillation across a slow straight drift."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.foundation.products import norm
from dynahoi_lerobot.motions.base import MOTIONS, PrescribedMotion
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import Vector, as_vector


@MOTIONS.register("harmonic_drift")
@dataclass(frozen=True)
class HarmonicDrift(PrescribedMotion):
    """r = meeting + u v tau + n A sin(w t + phase), n at right angles to u: drift 0.08 to 0.3 m/s, A 0.08 to 0.22 m.

    Attributes:
        meeting: centre of the oscillation at ``meeting_s`` [m].
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
    name: ClassVar[str] = "harmonic_drift"
    category: ClassVar[str] = "hybrid"
    phrase: ClassVar[str] = "oscillating while it drifts along"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw drift and oscillation."""
        speed, amplitude = draw.sample_speed(0.08, 0.3), draw.uniform(0.08, 0.22)
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
        return np.asarray(self.meeting) + drifted + self._aside(np.sin(self._phase(time_s)))

    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s]."""
        return np.asarray(self.drift) + self._aside(self.rate_rad_s * np.cos(self._phase(time_s)))

    def acceleration(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) acceleration [m/s^2]."""
        return self._aside(-(self.rate_rad_s**2) * np.sin(self._phase(time_s)))

    def _phase(self, time_s: np.ndarray) -> np.ndarray:
        return self.rate_rad_s * time_s + self.phase_rad

    def _aside(self, amount: np.ndarray) -> np.ndarray:
        return self.amplitude_m * amount[:, None] * np.asarray(self.across)
