"""Straight line at constant speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.straight import RISE_M, StraightMotion


@MOTIONS.register("constant")
@dataclass(frozen=True)
class Constant(StraightMotion):
    """Speed 0.2 to 0.9 m/s, kept."""

    name: ClassVar[str] = "constant"
    phrase: ClassVar[str] = "moving in a straight line at constant speed"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw a speed and a direction that stays off the floor."""
        speed = draw.sample_speed(0.2, 0.9)
        direction = draw.level_heading(RISE_M, speed * draw.horizon_s)
        return cls(draw.meeting_point(), direction, draw.intercept_s, speed, 0.0)
