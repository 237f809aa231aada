"""Base class of pendulums: the target hangs from a rigid massless string."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.foundation.products import product
from dynahoi_lerobot.motions.base import PhysicalMotion
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.geometry import Vector, as_vector
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2, Launch, Tether
from dynahoi_lerobot.objects import TargetObject


@dataclass(frozen=True)
class SuspendedMotion(PhysicalMotion):
    """A compound pendulum: the target turns with the string, so its moment of inertia adds to m l^2.

    Attributes:
        anchor: where the string is fixed [m].
        length_m: from the anchor to the target's centre, 0.3 to 1.1 m.
        angle_rad: of the string with the vertical at t = 0.
        yaw_rad: horizontal direction of the initial deflection.
        drag_1_s: drag over mass, so amplitudes decay as exp(-drag t / 2).
    """

    anchor: Vector
    length_m: float
    angle_rad: float
    yaw_rad: float
    drag_1_s: float
    category: ClassVar[str] = "pendulum"

    @classmethod
    def hanging(cls, draw: Draw, angle_rad: float, drag_1_s: float = 0.0) -> Self:
        """Return a pendulum of drawn length and direction whose lowest point is the meeting point."""
        length = draw.uniform(0.3, 1.1)
        anchor = np.asarray(draw.meeting_point()) + [0.0, 0.0, length]
        return cls(as_vector(anchor), length, angle_rad, draw.angle(), drag_1_s)

    def launch(self, target: TargetObject) -> Launch:
        """Return the deflected start, string and target tilted alike."""
        deflection = np.array([np.cos(self.yaw_rad), np.sin(self.yaw_rad), 0.0])
        down = deflection * np.sin(self.angle_rad) - np.array([0.0, 0.0, np.cos(self.angle_rad)])
        axis = np.cross(deflection, [0.0, 0.0, 1.0])
        half = self.angle_rad / 2
        quat = (float(np.cos(half)), *as_vector(axis * np.sin(half)))
        rate_w = self.precession_rad_s(target) * np.array([0.0, 0.0, 1.0])
        return Launch(
            as_vector(np.asarray(self.anchor) + self.length_m * down),
            quat=quat,
            velocity=as_vector(np.cross(rate_w, self.length_m * down)),
            spin=as_vector(_into_frame(rate_w, axis, self.angle_rad)),
            tether=Tether(self.anchor),
            drag_kg_s=self.drag_1_s * target.mass_kg,
        )

    def precession_rad_s(self, target: TargetObject) -> float:
        """Return the initial angular speed about the vertical; none unless a kind says otherwise."""
        return 0.0

    def small_period_s(self, target: TargetObject) -> float:
        """Return the period of small swings [s], 2 pi sqrt((I + m l^2) / (m g l))."""
        about_anchor = max(target.inertia[:2]) + target.mass_kg * self.length_m**2
        return float(2 * np.pi * np.sqrt(about_anchor / (target.mass_kg * GRAVITY_M_S2 * self.length_m)))


def _into_frame(vector: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Components of a world vector in a frame that was turned by ``angle`` about ``axis`` (Rodrigues, backwards)."""
    c, s = np.cos(-angle), np.sin(-angle)
    return vector * c + np.cross(axis, vector) * s + axis * product(axis, vector) * (1 - c)
