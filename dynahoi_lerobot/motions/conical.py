"""A pendulum that circles at constant angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2
from dynahoi_lerobot.motions.suspended import SuspendedMotion
from dynahoi_lerobot.objects import TargetObject


@MOTIONS.register("conical")
@dataclass(frozen=True)
class ConicalPendulum(SuspendedMotion):
    """Steady precession at 12 to 32 degrees, started at exactly the speed that keeps the angle."""

    name: ClassVar[str] = "conical"
    phrase: ClassVar[str] = "circling on a string"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw length and angle."""
        return cls.hanging(draw, float(np.radians(draw.sample_speed(12, 32))))

    def precession_rad_s(self, target: TargetObject) -> float:
        """Return W with W^2 cos(a) (I + m l^2 - I_z) = m g l: the rigid body's steady precession."""
        effective = max(target.inertia[:2]) + target.mass_kg * self.length_m**2 - target.inertia[2]
        torque = target.mass_kg * GRAVITY_M_S2 * self.length_m
        return float(np.sqrt(torque / (effective * np.cos(self.angle_rad))))
