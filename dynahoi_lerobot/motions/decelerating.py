"""Straight line, slowing down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.straight import RISE_M, StraightMotion


@MOTIONS.register("decelerating")
@dataclass(frozen=True)
class Decelerating(StraightMotion):
    """Speed from 0.6 to 1.4 m/s at first, 0.03 to 0.12 m/s at the horizon, changing evenly."""

    name: ClassVar[str] = "decelerating"
    phrase: ClassVar[str] = "moving in a straight line and slowing down"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw the two speeds and a direction that stays off the floor."""
        speeds = (draw.sample_speed(0.6, 1.4), draw.sample_speed(0.03, 0.12))
        direction = draw.level_heading(RISE_M, sum(speeds) / 2 * draw.horizon_s)
        return cls.between(draw.meeting_point(), direction, draw.intercept_s, speeds, draw.horizon_s)
