"""Round targets that roll down a plank without slipping."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.core.conventions import ROLLING_FRICTION_M
from dynahoi_lerobot.core.numerics import cos, sin
from dynahoi_lerobot.motions.base import MOTIONS, Draw, PhysicalMotion
from dynahoi_lerobot.motions.launch import (
    GRAVITY_M_S2,
    Box,
    Launch,
    Quaternion,
    Vector,
    as_vector,
    heading,
    yaw_pitch_quat,
    yaw_quat,
)
from dynahoi_lerobot.objects import ObjectType, TargetObject

PLANK_HALF_THICKNESS_M = 0.012
PLANK_HALF_WIDTH_M = 0.07


@dataclass(frozen=True)
class RollingMotion(PhysicalMotion):
    """From rest with acceleration g (sin q - c cos q / r) / (1 + I / (m r^2)); c is the rolling
    friction [m].

    Attributes:
        meeting: center of the target ``run_m`` after its release, on the slope or at its foot [m].
        slope_rad: inclination q, 4 to 12 degrees.
        yaw_rad: horizontal direction of descent.
        run_m: distance from the release to ``meeting`` [m].
        release_s: time of release [s].
    """

    meeting: Vector
    slope_rad: float
    yaw_rad: float
    run_m: float
    release_s: float
    category: ClassVar[str] = "inclined_rolling"
    max_frames: ClassVar[int] = 79
    max_approach_frames: ClassVar[int] = 20

    @classmethod
    def suits(cls, kind: ObjectType) -> bool:
        """Tell whether they roll."""
        return kind.rolls

    @classmethod
    def rolled(cls, draw: Draw, run_m: float, until_s: float) -> Self:
        """Return a roll that reaches the meeting point at ``until_s`` [s], at most ``run_m`` [m]
        after its release.
        """
        slope = float(np.radians(draw.sample_speed(4, 12)))
        acceleration = rolling_acceleration(slope, draw.target)
        run = min(run_m, acceleration * until_s**2 / 2)
        yaw = np.pi + draw.uniform(-2.0, 2.0)
        return cls(
            draw.meeting_point(), slope, yaw, run, until_s - float(np.sqrt(2 * run / acceleration))
        )

    def launch(self, target: TargetObject) -> Launch:
        """Return the plank and the target at rest on it, its axis across the slope."""
        forward, normal = self.slope_axes()
        start = np.asarray(self.meeting) - self.run_m * forward
        return Launch(
            as_vector(start),
            quat=self._lying(),
            release_s=self.release_s,
            boxes=self.surfaces(target, forward, normal),
            friction=1.0,
        )

    def surfaces(
        self, target: TargetObject, forward: np.ndarray, normal: np.ndarray
    ) -> tuple[Box, ...]:
        """Return the boxes the target rolls on: one plank, from 12 cm above the start to 60 cm past
        the meeting.
        """
        return (self.plank(target, forward, normal, 0.6),)

    def plank(
        self, target: TargetObject, forward: np.ndarray, normal: np.ndarray, past_m: float
    ) -> Box:
        """Return the slope: from 12 cm above the start to ``past_m`` beyond the meeting point."""
        half_length = (self.run_m + 0.12 + past_m) / 2
        contact = np.asarray(self.meeting) - target.roll_radius_m * normal
        center = contact + (past_m - half_length) * forward - PLANK_HALF_THICKNESS_M * normal
        half_size = (half_length, PLANK_HALF_WIDTH_M, PLANK_HALF_THICKNESS_M)
        return Box(as_vector(center), half_size, yaw_pitch_quat(self.yaw_rad, self.slope_rad))

    def slope_axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the (3,) unit vectors down the slope and out of it."""
        flat = np.asarray(heading(self.yaw_rad))
        up = np.array([0.0, 0.0, 1.0])
        c = cos(self.slope_rad)
        s = sin(self.slope_rad)
        return c * flat - s * up, s * flat + c * up

    def _lying(self) -> Quaternion:
        """Lay the object's axis of symmetry horizontally across the slope."""
        half = self.yaw_rad / 2
        root = float(np.sqrt(0.5))
        c = float(cos(half))
        s = float(sin(half))
        return (
            c * root,
            -c * root,
            -s * root,
            s * root,
        )  # yaw about z after a quarter turn about -x


def rolling_acceleration(slope_rad: float, target: TargetObject) -> float:
    """Return the acceleration of rolling without slipping [m/s^2], against rolling friction."""
    ratio = target.inertia[2] / (target.mass_kg * target.roll_radius_m**2)
    drive = sin(slope_rad) - ROLLING_FRICTION_M / target.roll_radius_m * cos(slope_rad)
    return float(GRAVITY_M_S2 * drive / (1 + ratio))


@MOTIONS.register("ramp")
class Ramp(RollingMotion):
    """Intercepted after 0.15 to 0.6 m of slope."""

    phrase: ClassVar[str] = "rolling down a ramp"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw slope, direction and run."""
        return cls.rolled(draw, draw.uniform(0.15, 0.6), draw.intercept_s)


RUNOUT_HALF_M = 0.6


@MOTIONS.register("ramp_and_runout")
class RampAndRunout(RollingMotion):
    """Rolls down 0.1 to 0.4 m of slope and is intercepted on level ground 0.15 to 0.5 s later."""

    phrase: ClassVar[str] = "rolling down a ramp and out onto a level track"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw slope, direction and run; the foot is reached before the intercept."""
        level_s = min(draw.uniform(0.15, 0.5), 0.5 * draw.intercept_s)
        return cls.rolled(draw, draw.uniform(0.1, 0.4), draw.intercept_s - level_s)

    def surfaces(
        self, target: TargetObject, forward: np.ndarray, normal: np.ndarray
    ) -> tuple[Box, ...]:
        """Return the slope, which ends under the meeting point, and the level track that begins
        there.
        """
        flat = np.asarray(heading(self.yaw_rad))
        up = np.array([0.0, 0.0, 1.0])
        foot = np.asarray(self.meeting) - target.roll_radius_m * normal
        center = foot + RUNOUT_HALF_M * flat - PLANK_HALF_THICKNESS_M * up
        track = Box(
            as_vector(center),
            (RUNOUT_HALF_M, PLANK_HALF_WIDTH_M, PLANK_HALF_THICKNESS_M),
            yaw_quat(self.yaw_rad),
        )
        return (self.plank(target, forward, normal, 0.0), track)
