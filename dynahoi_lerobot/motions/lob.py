"""A high throw towards the hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.throw import ThrowMotion


@MOTIONS.register("lob")
@dataclass(frozen=True)
class Lob(ThrowMotion):
    """From 0.8 to 1.5 m in front, 0.5 to 0.85 s before the meeting, released 0.2 to 0.6 m below it."""

    name: ClassVar[str] = "lob"
    phrase: ClassVar[str] = "being lobbed towards the hand"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw direction, flight time, distance and height."""
        yaw = np.pi + draw.uniform(-0.5, 0.5)
        return cls.aimed(draw, draw.uniform(0.5, 0.85), yaw, draw.sample_speed(0.8, 1.5), draw.uniform(0.5, 0.9))
