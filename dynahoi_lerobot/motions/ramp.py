"""Rolling down a ramp, met on the slope."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.rolling import RollingMotion


@MOTIONS.register("ramp")
@dataclass(frozen=True)
class Ramp(RollingMotion):
    """Met after 0.15 to 0.6 m of slope."""

    name: ClassVar[str] = "ramp"
    phrase: ClassVar[str] = "rolling down a ramp"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw slope, direction and run."""
        return cls.rolled(draw, draw.uniform(0.15, 0.6), draw.intercept_s)
