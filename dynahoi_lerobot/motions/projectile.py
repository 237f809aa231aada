"""Thrown and bouncing targets."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS, Draw, PhysicalMotion
from dynahoi_lerobot.motions.launch import (
    GRAVITY_M_S2,
    Launch,
    Vector,
    as_vector,
    ballistic_velocity,
    heading,
)
from dynahoi_lerobot.objects import ObjectType, TargetObject

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
    def aimed(
        cls, draw: Draw, flight_s: float, yaw: float, distance_m: float, height_m: float
    ) -> Self:
        """Return the throw that covers ``distance_m`` towards ``yaw`` and passes the meeting point
        after ``flight_s``.

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
        return Launch(
            self.start, velocity=velocity, release_s=self.release_s, restitution=LANDING_RESTITUTION
        )


@MOTIONS.register("lob")
class Lob(ThrowMotion):
    """From 0.8 to 1.5 m in front, 0.5 to 0.85 s before the meeting, released 0.2 to 0.6 m below
    it.
    """

    phrase: ClassVar[str] = "being lobbed towards the hand"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw direction, flight time, distance and height."""
        yaw = np.pi + draw.uniform(-0.5, 0.5)
        return cls.aimed(
            draw, draw.uniform(0.5, 0.85), yaw, draw.sample_speed(0.8, 1.5), draw.uniform(0.5, 0.9)
        )


@MOTIONS.register("cross_throw")
class CrossThrow(ThrowMotion):
    """From 0.4 to 0.8 m away, 40 to 66 degrees in front of the side, 0.45 to 0.75 s before the
    meeting.
    """

    phrase: ClassVar[str] = "being thrown across the view"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw direction, flight time, distance and height."""
        yaw = draw.sign() * (np.pi / 2 + draw.uniform(0.7, 1.15))
        return cls.aimed(
            draw,
            draw.uniform(0.45, 0.75),
            yaw,
            draw.sample_speed(0.4, 0.8),
            draw.uniform(0.85, 1.1),
        )


@MOTIONS.register("bounce")
@dataclass(frozen=True)
class Bounce(PhysicalMotion):
    """Dropped from 0.5 to 0.9 m, approaching at 0.4 to 1.0 m/s; restitution 0.75 to 0.9.

    Attributes:
        start: point of release [m].
        velocity: horizontal velocity at release [m/s].
        release_s: time of release [s].
        restitution: rebound speed over impact speed.
    """

    start: Vector
    velocity: Vector
    release_s: float
    restitution: float
    category: ClassVar[str] = "projectile"
    phrase: ClassVar[str] = "bouncing off the floor"
    max_frames: ClassVar[int] = 59
    max_approach_frames: ClassVar[int] = 13

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw drop, drift and rebound; the meeting lies in the first rebound."""
        height = draw.uniform(0.5, 0.9)
        restitution = draw.uniform(0.75, 0.9)
        fall_s = np.sqrt(2 * (height - draw.target.rest_height_m) / GRAVITY_M_S2)
        meeting_s = fall_s * (1 + 2 * restitution * draw.uniform(0.15, 0.7))
        velocity = np.asarray(heading(np.pi + draw.uniform(-0.8, 0.8))) * draw.sample_speed(
            0.4, 1.0
        )
        start = np.asarray(draw.meeting_point()) - velocity * meeting_s
        start[2] = height
        return cls(
            as_vector(start),
            as_vector(velocity),
            max(0.0, draw.intercept_s - meeting_s),
            restitution,
        )

    @classmethod
    def suits(cls, kind: ObjectType) -> bool:
        """Tell whether it is the ball, which bounces the same way whatever side it lands on."""
        return kind.name == "ball"

    def launch(self, target: TargetObject) -> Launch:
        """Return the release above the floor, with horizontal velocity."""
        velocity = ballistic_velocity(self.velocity)
        return Launch(
            self.start, velocity=velocity, release_s=self.release_s, restitution=self.restitution
        )
