"""A pendulum that swings in a plane and loses amplitude to drag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.suspended import SuspendedMotion


@MOTIONS.register("damped")
@dataclass(frozen=True)
class DampedPendulum(SuspendedMotion):
    """Let go at rest at 20 to 45 degrees; drag over mass 0.15 to 0.5 per second."""

    name: ClassVar[str] = "damped"
    phrase: ClassVar[str] = "swinging on a string and slowly coming to rest"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw length, initial angle and drag."""
        return cls.hanging(draw, float(np.radians(draw.sample_speed(20, 45))), draw.uniform(0.15, 0.5))
