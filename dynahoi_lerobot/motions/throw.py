"""Base class of throws: the target is held, released, and flies freely past the meeting point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import PhysicalMotion
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import Vector, as_vector, heading
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2, Launch, ballistic_velocity
from dynahoi_lerobot.objects import TargetObject

LANDING_RESTITUTION = 0.1
"""Of the floor, where a target that was missed lands."""


@dataclass(frozen=True)
class ThrowMotion(PhysicalMotion):
    """Free flight: r(t) = start + v tau - g tau^2 / 2 z with tau = t - release.

    Attributes:
        start: point of release [m].
        velocity: at release [m/s].
        release_s: time of release [s]; the object is held still until then.
    """

    start: Vector
    velocity: Vector
    release_s: float
    category: ClassVar[str] = "projectile"
    max_frames: ClassVar[int] = 59
    max_approach_frames: ClassVar[int] = 11

    @classmethod
    def aimed(cls, draw: Draw, flight_s: float, yaw: float, distance_m: float, height_m: float) -> Self:
        """Return the throw that covers ``distance_m`` towards ``yaw`` and passes the meeting point after ``flight_s``.

        Args:
            draw: the episode's draw; the flight is no longer than its ``intercept_s``.
            flight_s: time from release to the meeting point [s].
            yaw: horizontal direction of flight [rad].
            distance_m: horizontal distance between release and meeting point.
            height_m: of the release point above the floor.
        """
        flight = min(flight_s, draw.intercept_s)
        meeting = np.asarray(draw.meeting_point())
        start = meeting - distance_m * np.asarray(heading(yaw))
        start[2] = height_m
        velocity = (meeting - start) / flight
        velocity[2] += GRAVITY_M_S2 * flight / 2
        return cls(as_vector(start), as_vector(velocity), draw.intercept_s - flight)

    def launch(self, target: TargetObject) -> Launch:
        """Return the release; the floor is the only surface."""
        velocity = ballistic_velocity(self.velocity)
        return Launch(self.start, velocity=velocity, release_s=self.release_s, restitution=LANDING_RESTITUTION)
