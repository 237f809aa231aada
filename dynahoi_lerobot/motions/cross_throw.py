"""A flat throw from one side to the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.throw import ThrowMotion


@MOTIONS.register("cross_throw")
@dataclass(frozen=True)
class CrossThrow(ThrowMotion):
    """From 0.4 to 0.8 m away, 40 to 66 degrees in front of the side, 0.45 to 0.75 s before the meeting."""

    name: ClassVar[str] = "cross_throw"
    phrase: ClassVar[str] = "being thrown across the view"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw direction, flight time, distance and height."""
        yaw = draw.sign() * (np.pi / 2 + draw.uniform(0.7, 1.15))
        return cls.aimed(draw, draw.uniform(0.45, 0.75), yaw, draw.sample_speed(0.4, 0.8), draw.uniform(0.85, 1.1))
