"""Targets on a level table of low friction that are struck or rebound from a wall."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS, Draw, PhysicalMotion
from dynahoi_lerobot.motions.launch import (
    GRAVITY_M_S2,
    Box,
    Launch,
    Striker,
    Vector,
    as_vector,
    heading,
    yaw_quat,
)
from dynahoi_lerobot.objects import ObjectType, TargetObject

TABLE_HALF_M = (1.1, 0.9, 0.02)


@dataclass(frozen=True)
class TabletopMotion(PhysicalMotion):
    """An impact on a level table of low friction.

    Attributes:
        contact: center of the target at the impact [m].
        yaw_rad: horizontal direction of what moves before the impact, the striker or the target.
        speed_m_s: its speed at the impact.
        impact_s: time of the impact [s]; earlier by less than a millisecond for a ball that begins
            to roll.
        restitution: rebound speed over approach speed.
        friction: sliding friction of the table.
    """

    contact: Vector
    yaw_rad: float
    speed_m_s: float
    impact_s: float
    restitution: float
    friction: float
    category: ClassVar[str] = "impact_response"
    max_frames: ClassVar[int] = 79
    max_approach_frames: ClassVar[int] = 20

    @classmethod
    def suits(cls, kind: ObjectType) -> bool:
        """Tell whether they slide."""
        return kind.slides

    def table(self, target: TargetObject) -> Box:
        """Return the table under the target."""
        top = np.asarray(self.contact) - [0.0, 0.0, target.rest_height_m + TABLE_HALF_M[2]]
        return Box(as_vector(top), TABLE_HALF_M, yaw_quat(self.yaw_rad), friction=self.friction)

    def direction(self) -> np.ndarray:
        """Return the (3,) unit vector along ``yaw_rad``, world."""
        return np.asarray(heading(self.yaw_rad))


def reach_m(target: TargetObject) -> float:
    """Return how far an upright target extends from its center along its x axis [m].

    Impacts are along that axis, so that boxes are hit in the middle of a face.
    """
    return max(
        primitive.half_size[0] + (0.0 if primitive.shape == "box" else abs(primitive.pos[0]))
        for primitive in target.primitives
    )


STRIKER_RADIUS_M = 0.02


@MOTIONS.register("struck")
class Struck(TabletopMotion):
    """Striker of equal mass at 0.6 to 1.2 m/s, restitution 0.5 to 0.85, table friction 0.02 to
    0.06.
    """

    phrase: ClassVar[str] = "struck by a ball"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw speed, direction, materials; the impact is 0.25 to 0.6 s before the intercept and
        within the window.
        """
        impact_s = max(0.05, min(draw.intercept_s - draw.uniform(0.25, 0.6), draw.window_s - 0.1))
        speed = draw.sample_speed(0.6, 1.2)
        yaw = np.pi + draw.uniform(-1.9, 1.9)
        return cls(
            draw.meeting_point(),
            yaw,
            speed,
            impact_s,
            draw.uniform(0.5, 0.85),
            draw.uniform(0.02, 0.06),
        )

    def launch(self, target: TargetObject) -> Launch:
        """Return the target at rest on the table and the striker in flight."""
        gap = reach_m(target) + STRIKER_RADIUS_M + self.speed_m_s * self.impact_s
        start = np.asarray(self.contact) - gap * self.direction()
        velocity = as_vector(self.speed_m_s * self.direction())
        return Launch(
            self.contact,
            quat=yaw_quat(self.yaw_rad),
            boxes=(self.table(target),),
            striker=Striker(
                as_vector(start), velocity, STRIKER_RADIUS_M, target.mass_kg, self.restitution
            ),
            friction=0.0,
        )


WALL_HALF_M = (0.02, 0.3, 0.05)


@MOTIONS.register("wall_rebound")
class WallRebound(TabletopMotion):
    """Meets the wall at 0.5 to 1.1 m/s, restitution 0.6 to 0.9, table friction 0.01 to 0.04."""

    phrase: ClassVar[str] = "rebounding from a wall"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw speed, direction, materials; the wall is hit 0.2 to 0.6 s before the intercept and
        within the window.
        """
        impact_s = max(0.05, min(draw.intercept_s - draw.uniform(0.2, 0.6), draw.window_s - 0.05))
        yaw = draw.uniform(-2.2, 2.2)
        return cls(
            draw.meeting_point(), yaw, draw.sample_speed(0.5, 1.1), impact_s,
            draw.uniform(0.6, 0.9), draw.uniform(0.01, 0.04),
        )  # fmt: skip

    def launch(self, target: TargetObject) -> Launch:
        """Return the target sliding on the table, fast enough to meet the wall at ``impact_s``, and
        the wall.
        """
        direction = self.direction()
        reach = reach_m(target)
        lost = (
            self.friction * GRAVITY_M_S2 * self.impact_s
        )  # speed lost to friction on the way [m/s]
        distance = (self.speed_m_s + lost / 2) * self.impact_s
        wall = np.asarray(self.contact) + (reach + WALL_HALF_M[0]) * direction
        wall[2] += WALL_HALF_M[2] - target.rest_height_m
        return Launch(
            as_vector(np.asarray(self.contact) - distance * direction),
            quat=yaw_quat(self.yaw_rad),
            velocity=as_vector((self.speed_m_s + lost) * direction),
            boxes=(
                self.table(target),
                Box(as_vector(wall), WALL_HALF_M, yaw_quat(self.yaw_rad), self.restitution),
            ),
            friction=0.0,
        )
