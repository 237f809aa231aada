"""An object at rest on a table is struck by a flying ball and slides away."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import as_vector, yaw_quat
from dynahoi_lerobot.motions.launch import Launch, Striker
from dynahoi_lerobot.motions.tabletop import TabletopMotion, reach_m
from dynahoi_lerobot.objects import TargetObject

STRIKER_RADIUS_M = 0.02


@MOTIONS.register("struck")
@dataclass(frozen=True)
class Struck(TabletopMotion):
    """Striker of equal mass at 0.6 to 1.2 m/s, restitution 0.5 to 0.85, table friction 0.02 to 0.06."""

    name: ClassVar[str] = "struck"
    phrase: ClassVar[str] = "struck by a ball"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw speed, direction, materials; the impact is 0.25 to 0.6 s before the intercept and within the window."""
        impact_s = max(0.05, min(draw.intercept_s - draw.uniform(0.25, 0.6), draw.window_s - 0.1))
        speed = draw.sample_speed(0.6, 1.2)
        yaw = np.pi + draw.uniform(-1.9, 1.9)
        return cls(
            draw.meeting_point(), yaw, speed, impact_s, draw.uniform(0.5, 0.85), draw.uniform(0.02, 0.06)
        )  # fmt: skip

    def launch(self, target: TargetObject) -> Launch:
        """Return the target at rest on the table and the striker in flight."""
        gap = reach_m(target) + STRIKER_RADIUS_M + self.speed_m_s * self.impact_s
        start = np.asarray(self.contact) - gap * self.direction()
        velocity = as_vector(self.speed_m_s * self.direction())
        return Launch(
            self.contact,
            quat=yaw_quat(self.yaw_rad),
            boxes=(self.table(target),),
            striker=Striker(as_vector(start), velocity, STRIKER_RADIUS_M, target.mass_kg, self.restitution),
            friction=0.0,
        )
