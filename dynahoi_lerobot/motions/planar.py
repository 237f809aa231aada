"""A pendulum that swings in a plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.suspended import SuspendedMotion


@MOTIONS.register("planar")
@dataclass(frozen=True)
class PlanarPendulum(SuspendedMotion):
    """Let go at rest at 12 to 40 degrees."""

    name: ClassVar[str] = "planar"
    phrase: ClassVar[str] = "swinging on a string"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw length and initial angle."""
        return cls.hanging(draw, float(np.radians(draw.sample_speed(12, 40))))
