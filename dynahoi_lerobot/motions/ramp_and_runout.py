"""Rolling down a ramp and out along a level table, met on the level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import as_vector, heading, yaw_quat
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.motions.rolling import PLANK_HALF_THICKNESS_M, PLANK_HALF_WIDTH_M, RollingMotion
from dynahoi_lerobot.objects import TargetObject

RUNOUT_HALF_M = 0.6


@MOTIONS.register("ramp_and_runout")
@dataclass(frozen=True)
class RampAndRunout(RollingMotion):
    """Reaches the foot of 0.1 to 0.4 m of slope 0.15 to 0.5 s before it is met on the level."""

    name: ClassVar[str] = "ramp_and_runout"
    phrase: ClassVar[str] = "rolling down a ramp and out onto a level track"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw slope, direction and run; the foot is reached before the intercept."""
        level_s = min(draw.uniform(0.15, 0.5), 0.5 * draw.intercept_s)
        return cls.rolled(draw, draw.uniform(0.1, 0.4), draw.intercept_s - level_s)

    def surfaces(self, target: TargetObject, forward: np.ndarray, normal: np.ndarray) -> tuple[Box, ...]:
        """Return the slope, which ends under the meeting point, and the level track that begins there."""
        flat, up = np.asarray(heading(self.yaw_rad)), np.array([0.0, 0.0, 1.0])
        foot = np.asarray(self.meeting) - target.roll_radius_m * normal
        center = foot + RUNOUT_HALF_M * flat - PLANK_HALF_THICKNESS_M * up
        track = Box(
            as_vector(center), (RUNOUT_HALF_M, PLANK_HALF_WIDTH_M, PLANK_HALF_THICKNESS_M), yaw_quat(self.yaw_rad)
        )
        return (self.plank(target, forward, normal, 0.0), track)
