"""Targets that hang from a rigid massless string."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.core.numerics import cos, product, sin
from dynahoi_lerobot.motions.base import MOTIONS, Draw, PhysicalMotion
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2, Launch, Vector, as_vector
from dynahoi_lerobot.objects import TargetObject


@dataclass(frozen=True)
class SuspendedMotion(PhysicalMotion):
    """A compound pendulum: the target turns with the string, so its moment of inertia adds to m
    l^2.

    Attributes:
        anchor: where the string is fixed [m].
        length_m: from the anchor to the target's center, 0.3 to 1.1 m.
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
        """Return a pendulum of drawn length and direction whose lowest point is the meeting
        point.
        """
        length = draw.uniform(0.3, 1.1)
        anchor = np.asarray(draw.meeting_point()) + [0.0, 0.0, length]
        return cls(as_vector(anchor), length, angle_rad, draw.angle(), drag_1_s)

    def launch(self, target: TargetObject) -> Launch:
        """Return the deflected start, string and target tilted alike."""
        deflection = np.array([cos(self.yaw_rad), sin(self.yaw_rad), 0.0])
        down = deflection * sin(self.angle_rad) - np.array([0.0, 0.0, cos(self.angle_rad)])
        axis = np.cross(deflection, [0.0, 0.0, 1.0])
        half = self.angle_rad / 2
        quat = (float(cos(half)), *as_vector(axis * sin(half)))
        rate_w = self.precession_rad_s(target) * np.array([0.0, 0.0, 1.0])
        return Launch(
            as_vector(np.asarray(self.anchor) + self.length_m * down),
            quat=quat,
            velocity=as_vector(np.cross(rate_w, self.length_m * down)),
            spin=as_vector(_into_frame(rate_w, axis, self.angle_rad)),
            tether=self.anchor,
            drag_kg_s=self.drag_1_s * target.mass_kg,
        )

    def precession_rad_s(self, target: TargetObject) -> float:
        """Return the initial angular speed about the vertical; none unless a kind says
        otherwise.
        """
        return 0.0


def _into_frame(vector: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Components of a world vector in a frame that was turned by ``angle`` about ``axis``
    (Rodrigues, backwards).
    """
    c = cos(-angle)
    s = sin(-angle)
    return vector * c + np.cross(axis, vector) * s + axis * product(axis, vector) * (1 - c)


@MOTIONS.register("planar")
class PlanarPendulum(SuspendedMotion):
    """Released at rest at 12 to 40 degrees."""

    phrase: ClassVar[str] = "swinging on a string"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw length and initial angle."""
        return cls.hanging(draw, float(np.radians(draw.sample_speed(12, 40))))


@MOTIONS.register("conical")
class ConicalPendulum(SuspendedMotion):
    """Steady precession at 12 to 32 degrees, started at exactly the speed that keeps the angle."""

    phrase: ClassVar[str] = "circling on a string"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw length and angle."""
        return cls.hanging(draw, float(np.radians(draw.sample_speed(12, 32))))

    def precession_rad_s(self, target: TargetObject) -> float:
        """Return W with W^2 cos(a) (I + m l^2 - I_z) = m g l: the rigid body's steady
        precession.
        """
        effective = max(target.inertia[:2]) + target.mass_kg * self.length_m**2 - target.inertia[2]
        torque = target.mass_kg * GRAVITY_M_S2 * self.length_m
        return float(np.sqrt(torque / (effective * cos(self.angle_rad))))


@MOTIONS.register("damped")
class DampedPendulum(SuspendedMotion):
    """Released at rest at 20 to 45 degrees; drag over mass 0.15 to 0.5 per second."""

    phrase: ClassVar[str] = "swinging on a string and slowly coming to rest"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw length, initial angle and drag."""
        return cls.hanging(
            draw, float(np.radians(draw.sample_speed(20, 45))), draw.uniform(0.15, 0.5)
        )
