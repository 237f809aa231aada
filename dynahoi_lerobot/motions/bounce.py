"""A ball that falls, bounces off the floor and rises again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS, PhysicalMotion
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import Vector, as_vector, heading
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2, Launch, ballistic_velocity
from dynahoi_lerobot.objects import TargetObject


@MOTIONS.register("bounce")
@dataclass(frozen=True)
class Bounce(PhysicalMotion):
    """Dropped from 0.5 to 0.9 m, coming at 0.4 to 1.0 m/s; restitution 0.75 to 0.9.

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
    name: ClassVar[str] = "bounce"
    category: ClassVar[str] = "projectile"
    phrase: ClassVar[str] = "bouncing off the floor"
    max_frames: ClassVar[int] = 59
    max_approach_frames: ClassVar[int] = 13

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw drop, drift and rebound; the meeting lies in the first rebound."""
        height, restitution = draw.uniform(0.5, 0.9), draw.uniform(0.75, 0.9)
        fall_s = np.sqrt(2 * (height - draw.target.rest_height_m) / GRAVITY_M_S2)
        meeting_s = fall_s * (1 + 2 * restitution * draw.uniform(0.15, 0.7))
        velocity = np.asarray(heading(np.pi + draw.uniform(-0.8, 0.8))) * draw.sample_speed(0.4, 1.0)
        start = np.asarray(draw.meeting_point()) - velocity * meeting_s
        start[2] = height
        return cls(as_vector(start), as_vector(velocity), max(0.0, draw.intercept_s - meeting_s), restitution)

    @classmethod
    def objects(cls) -> list[str]:
        """Return the ball, which bounces the same way whatever side it lands on."""
        return ["ball"]

    def launch(self, target: TargetObject) -> Launch:
        """Return the release above the floor, with horizontal velocity."""
        velocity = ballistic_velocity(self.velocity)
        return Launch(self.start, velocity=velocity, release_s=self.release_s, restitution=self.restitution)
