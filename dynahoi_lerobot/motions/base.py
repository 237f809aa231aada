"""Base classes of motions: a prescribed path, or an initial condition for real dynamics.

The paper names three tiers and eight categories (Section 3.2); the 22 kinds and their ranges are
ours.
"""

import json
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.core.numerics import arcsin
from dynahoi_lerobot.core.registry import Registry
from dynahoi_lerobot.motions.launch import Launch, Vector, as_vector, heading
from dynahoi_lerobot.objects import ObjectType, TargetObject

MEETING_CENTER_W = np.array([0.0, 0.0, 1.1])
"""Middle of the region in which hand and target meet [m], world."""
MEETING_HALF_SIDE_M = 0.15
STEEPEST_SINE = 0.7


@dataclass(frozen=True)
class Draw:
    """What a motion may depend on when its parameters are drawn.

    Attributes:
        rng: the episode's random numbers.
        target: the object that will move.
        window_s: end of the observation window [s] from the start of the episode.
        intercept_s: when the target should be at the meeting point [s], or near it.
        horizon_s: how long the motion must stay inside the arena [s].
        speed_scale: 1 for the speeds of training; see ``sample_speed``.
    """

    rng: np.random.Generator
    target: TargetObject
    window_s: float
    intercept_s: float
    horizon_s: float
    speed_scale: float = 1.0

    def uniform(self, low: float, high: float) -> float:
        """Draw uniformly from [low, high)."""
        return float(self.rng.uniform(low, high))

    def sample_speed(self, low: float, high: float) -> float:
        """Draw a speed, or a frequency, angle or distance that decides one.

        Uniform in [low, high) where ``speed_scale`` is 1, and otherwise in [high, speed_scale *
        high), which training never reaches. The result has the unit of the bounds.
        """
        if self.speed_scale == 1.0:
            return self.uniform(low, high)
        return self.uniform(high, self.speed_scale * high)

    def sign(self) -> float:
        """Draw -1 or 1."""
        return float(self.rng.choice((-1.0, 1.0)))

    def angle(self) -> float:
        """Draw an angle in [0, 2 pi) [rad]."""
        return self.uniform(0.0, 2 * np.pi)

    def meeting_point(self) -> Vector:
        """Draw the point where hand and target should meet [m], world: within a cube of 30 cm."""
        return as_vector(
            MEETING_CENTER_W + self.rng.uniform(-MEETING_HALF_SIDE_M, MEETING_HALF_SIDE_M, 3)
        )

    def level_heading(self, rise_m: float, path_m: float) -> Vector:
        """Draw a unit vector, world, along which height changes by at most ``rise_m`` over
        ``path_m`` of path [m].
        """
        steepest = float(arcsin(min(STEEPEST_SINE, rise_m / max(path_m, 1e-9))))
        return heading(self.angle(), self.uniform(-steepest, steepest))


CATEGORIES: dict[str, tuple[str, str]] = {
    "straight_line": ("kinematic", "linear"),
    "simple_harmonic": ("kinematic", "periodic"),
    "circular_arc": ("kinematic", "circular"),
    "projectile": ("physical", "linear"),
    "pendulum": ("physical", "periodic"),
    "inclined_rolling": ("physical", "linear"),
    "impact_response": ("physical", "linear"),
    "hybrid": ("stochastic", "hybrid"),
}
"""Category to (tier, periodicity): Section 3.2 and Appendix "Stratified Performance Analysis"."""


class Motion(ABC):
    """A kind of motion; an instance is one motion with its parameters (a frozen dataclass, SI
    units, world frame).

    Class attributes:
        name: the registered name.
        category: one of ``CATEGORIES``.
        phrase: how an instruction describes the motion, after "the object that is".
        max_frames: longest recording in which the motion is still under way [frames].
        max_approach_frames: latest intercept [frames after the control start]; motions that end
        soon are met early.
    """

    name: ClassVar[str]
    category: ClassVar[str]
    phrase: ClassVar[str]
    max_frames: ClassVar[int] = 160
    max_approach_frames: ClassVar[int] = 40

    @classmethod
    @abstractmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw the parameters of one motion."""

    @classmethod
    def suits(cls, kind: ObjectType) -> bool:
        """Tell whether objects of that type can move this way: all of them, unless a kind of motion
        overrides it.
        """
        return True

    def launch(self, target: TargetObject) -> Launch:
        """Return the initial condition of ``target`` and the fixtures around it; a closed form has
        neither.
        """
        return Launch((0.0, 0.0, 0.0))

    def parameters(self) -> str:
        """Return the parameters as JSON, SI units."""
        return json.dumps(asdict(self), sort_keys=True)  # type: ignore[call-overload]


MOTIONS: Registry[type[Motion]] = Registry("motion", Motion, needs=("category", "phrase"))


class PrescribedMotion(Motion):
    """A path in closed form. The simulation drives the target along it, with the force that this
    path requires.
    """

    @abstractmethod
    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m], world, at (K,) times [s]."""


@dataclass(frozen=True)
class Retimed(PrescribedMotion):
    """The path of another motion, traversed at another rate: r(t) = motion.r(path_s + rate (t -
    time_s)).

    Attributes:
        motion: whose path it is; this has its name, category and phrase.
        rate: how many times as fast.
        time_s: when it is [s] ...
        path_s: ... where the motion is at that time [s].
    """

    motion: PrescribedMotion
    rate: float
    time_s: float
    path_s: float

    def __post_init__(self) -> None:
        for attribute in ("name", "category", "phrase"):
            object.__setattr__(self, attribute, getattr(self.motion, attribute))

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        """Raise TypeError: only the motion itself can be drawn."""
        raise TypeError("draw the motion that is retimed")

    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m]."""
        return self.motion.position(self.path_s + self.rate * (time_s - self.time_s))


class PhysicalMotion(Motion):
    """An initial condition; MuJoCo simulates where the target goes from there."""

    @abstractmethod
    def launch(self, target: TargetObject) -> Launch:
        """Return the initial condition of ``target`` and the fixtures around it."""
