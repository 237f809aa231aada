"""What a motion is drawn from: random numbers, the object that moves, and the times the motion has to fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.motions.geometry import Vector, as_vector, heading
from dynahoi_lerobot.objects import TargetObject

MEETING_CENTER_W = np.array([0.0, 0.0, 1.1])
"""Middle of the region in which hand and target meet [m], world."""
MEETING_HALF_SIDE_M = 0.15
STEEPEST_SINE = 0.7


@dataclass(frozen=True)
class Draw:
    """What a motion may depend on when its parameters are drawn.

    Attributes:
        rng: the episode's random numbers.
        target: the object that will move.
        window_s: end of the observation window [s] from the start of the episode.
        intercept_s: when the target should be at the meeting point [s], or near it.
        horizon_s: how long the motion must stay inside the arena [s].
        speed_scale: 1 for the speeds of training; see ``sample_speed``.
    """

    rng: np.random.Generator
    target: TargetObject
    window_s: float
    intercept_s: float
    horizon_s: float
    speed_scale: float = 1.0

    def uniform(self, low: float, high: float) -> float:
        """Draw uniformly from [low, high)."""
        return float(self.rng.uniform(low, high))

    def sample_speed(self, low: float, high: float) -> float:
        """Draw a speed, or a frequency, angle or distance that decides one.

        Uniform in [low, high) where ``speed_scale`` is 1, and otherwise in [high, speed_scale * high), which training
        never reaches. The unit is that of the bounds.
        """
        if self.speed_scale == 1.0:
            return self.uniform(low, high)
        return self.uniform(high, self.speed_scale * high)

    def sign(self) -> float:
        """Draw -1 or 1."""
        return float(self.rng.choice((-1.0, 1.0)))

    def angle(self) -> float:
        """Draw an angle in [0, 2 pi) [rad]."""
        return self.uniform(0.0, 2 * np.pi)

    def meeting_point(self) -> Vector:
        """Draw the point where hand and target should meet [m], world: within a cube of 30 cm."""
        return as_vector(MEETING_CENTER_W + self.rng.uniform(-MEETING_HALF_SIDE_M, MEETING_HALF_SIDE_M, 3))

    def level_heading(self, rise_m: float, path_m: float) -> Vector:
        """Draw a unit vector, world, along which height changes by at most ``rise_m`` over ``path_m`` of path [m]."""
        steepest = float(np.arcsin(min(STEEPEST_SINE, rise_m / max(path_m, 1e-9))))
        return heading(self.angle(), self.uniform(-steepest, steepest))
