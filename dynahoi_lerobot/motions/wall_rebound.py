"""An object slides along a table into a wall and rebounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import as_vector, yaw_quat
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2, Box, Launch
from dynahoi_lerobot.motions.tabletop import TabletopMotion, reach_m
from dynahoi_lerobot.objects import TargetObject

WALL_HALF_M = (0.02, 0.3, 0.05)


@MOTIONS.register("wall_rebound")
@dataclass(frozen=True)
class WallRebound(TabletopMotion):
    """Meets the wall at 0.5 to 1.1 m/s, restitution 0.6 to 0.9, table friction 0.01 to 0.04."""

    name: ClassVar[str] = "wall_rebound"
    phrase: ClassVar[str] = "rebounding from a wall"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw speed, direction, materials; the wall is hit 0.2 to 0.6 s before the intercept and within the window."""
        impact_s = max(0.05, min(draw.intercept_s - draw.uniform(0.2, 0.6), draw.window_s - 0.05))
        yaw = draw.uniform(-2.2, 2.2)
        return cls(
            draw.meeting_point(), yaw, draw.sample_speed(0.5, 1.1), impact_s,
            draw.uniform(0.6, 0.9), draw.uniform(0.01, 0.04),
        )  # fmt: skip

    def launch(self, target: TargetObject) -> Launch:
        """Return the target sliding on the table, fast enough to meet the wall at ``impact_s``, and the wall."""
        direction, reach = self.direction(), reach_m(target)
        lost = self.friction * GRAVITY_M_S2 * self.impact_s  # speed lost to friction on the way [m/s]
        distance = (self.speed_m_s + lost / 2) * self.impact_s
        wall = np.asarray(self.contact) + (reach + WALL_HALF_M[0]) * direction
        wall[2] += WALL_HALF_M[2] - target.rest_height_m
        return Launch(
            as_vector(np.asarray(self.contact) - distance * direction),
            quat=yaw_quat(self.yaw_rad),
            velocity=as_vector((self.speed_m_s + lost) * direction),
            boxes=(self.table(target), Box(as_vector(wall), WALL_HALF_M, yaw_quat(self.yaw_rad), self.restitution)),
            friction=0.0,
        )
