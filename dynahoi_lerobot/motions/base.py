"""What a motion is: either a prescribed path with exact derivatives, or an initial condition for real dynamics.

The paper names three tiers and eight categories (Section 3.2); the 22 kinds and all their ranges are ours.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.objects.base import OBJECTS

Vector = tuple[float, float, float]

MOTIONS: Registry[type[Motion]] = Registry("motion", "dynahoi_lerobot.motions")

GRAVITY_M_S2 = 9.81
STAGE_CENTER_W = np.array([0.0, 0.0, 1.1])
"""Middle of the region where targets are met, world [m]."""

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


@dataclass(frozen=True)
class Draw:
    """What a motion may depend on when its parameters are drawn.

    Attributes:
        rng: the episode's random numbers.
        target: the object that will move.
        window_s: end of the observation window [s].
        intercept_s: when the target should be in reach [s].
        horizon_s: how long the motion must stay inside the arena [s].
        tempo: 1 in training, more in ``ood_speed``; see ``pace``.
    """

    rng: np.random.Generator
    target: TargetObject
    window_s: float
    intercept_s: float
    horizon_s: float
    tempo: float = 1.0

    def uniform(self, low: float, high: float) -> float:
        """Draw uniformly from [low, high)."""
        return float(self.rng.uniform(low, high))

    def pace(self, low: float, high: float) -> float:
        """Draw a speed, or what makes one: from [low, high) in training, from [high, tempo * high) in ``ood_speed``."""
        return self.uniform(low, high) if self.tempo == 1.0 else self.uniform(high, self.tempo * high)

    def sign(self) -> float:
        """Draw -1 or 1."""
        return float(self.rng.choice((-1.0, 1.0)))

    def angle(self) -> float:
        """Draw an angle in [0, 2 pi) [rad]."""
        return self.uniform(0.0, 2 * np.pi)

    def meeting_point(self) -> Vector:
        """Draw a point near the centre of the stage, world [m]."""
        return as_vector(STAGE_CENTER_W + self.rng.uniform(-0.15, 0.15, 3))


class Motion(ABC):
    """A kind of motion; an instance is one motion with its parameters (a frozen dataclass, SI units, world frame)."""

    name: ClassVar[str]
    category: ClassVar[str]
    phrase: ClassVar[str]
    """How an instruction describes the motion, after "the object that is"."""
    held_out: ClassVar[bool] = False
    """Whether it never appears in training; only ``ood_motion`` uses it."""
    max_frames: ClassVar[int] = 160
    """Longest recording [frames] in which the motion still makes sense."""
    max_approach_frames: ClassVar[int] = 40
    """Latest intercept [frames after the control start]; short-lived motions are met early."""

    @classmethod
    @abstractmethod
    def sample(cls, draw: Draw) -> Self:
        """Draw parameters."""

    @classmethod
    def objects(cls) -> list[str]:
        """Return the names of the objects that can move this way; all of them unless a kind says otherwise."""
        return OBJECTS.names()

    def parameters(self) -> str:
        """Return the parameters as JSON, SI units."""
        return json.dumps(asdict(self), sort_keys=True)  # type: ignore[call-overload]


class PrescribedMotion(Motion):
    """A path given in closed form. The target follows it exactly, driven by the force that the path requires."""

    @abstractmethod
    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m], world, at (K,) times [s]."""

    @abstractmethod
    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s], the exact derivative of ``position``."""

    @abstractmethod
    def acceleration(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) acceleration [m/s^2], the exact derivative of ``velocity``."""


@dataclass(frozen=True)
class Box:
    """A static box: centre [m], orientation wxyz and half extents [m], world."""

    pos: Vector
    half_size: Vector
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Tether:
    """A massless rigid string from the target's centre up to ``anchor`` [m], world."""

    anchor: Vector


@dataclass(frozen=True)
class Striker:
    """A floating ball that flies straight from ``pos`` [m] with ``velocity`` [m/s] and hits the target.

    Attributes:
        radius_m: its radius; ``mass_kg``: its mass.
    """

    pos: Vector
    velocity: Vector
    radius_m: float
    mass_kg: float


@dataclass(frozen=True)
class Launch:
    """Where a physical motion begins and in what surroundings.

    Attributes:
        pos: centre of the target [m], world; ``quat``: orientation wxyz.
        velocity: linear [m/s], world; ``spin``: angular [rad/s], target frame.
        release_s: the target is held still at ``pos`` until then [s], and leaves with ``velocity``.
        boxes: up to two static boxes.
        damping_ratio: of the target's contacts; below 1 they rebound (see ``damping_ratio_for``).
        friction: sliding friction against surfaces, None for the object's own.
        drag_kg_s: linear drag on the centre [N s/m].
    """

    pos: Vector
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    spin: Vector = (0.0, 0.0, 0.0)
    release_s: float = 0.0
    boxes: tuple[Box, ...] = ()
    tether: Tether | None = None
    striker: Striker | None = None
    damping_ratio: float = 1.0
    friction: float | None = None
    drag_kg_s: float = 0.0


class PhysicalMotion(Motion):
    """Real dynamics from an initial condition; where it goes is what MuJoCo says."""

    @abstractmethod
    def launch(self, target: TargetObject) -> Launch:
        """Return the initial condition and the surroundings of ``target``."""


def benchmark_motions() -> list[str]:
    """Return the 22 kinds of the benchmark, sorted by name."""
    return [name for name, kind in MOTIONS.items() if not kind.held_out]


def as_vector(values: np.ndarray) -> Vector:
    """Return three plain floats."""
    x, y, z = (float(v) for v in values)
    return (x, y, z)


def heading(yaw: float, pitch: float = 0.0) -> Vector:
    """Return the unit vector at ``yaw`` from +x towards +y and ``pitch`` above the horizon [rad]."""
    flat = np.cos(pitch)
    return (float(np.cos(yaw) * flat), float(np.sin(yaw) * flat), float(np.sin(pitch)))


def level_heading(draw: Draw, rise_m: float, path_m: float) -> Vector:
    """Draw a direction whose height changes by at most ``rise_m`` over ``path_m`` of path [m]."""
    steepest = float(np.arcsin(min(0.7, rise_m / max(path_m, 1e-9))))
    return heading(draw.angle(), draw.uniform(-steepest, steepest))


def yaw_quat(yaw: float) -> tuple[float, float, float, float]:
    """Return the rotation by ``yaw`` [rad] about z, wxyz."""
    return (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2)))


def damping_ratio_for(restitution: float) -> float:
    """Return the contact damping ratio that rebounds with ``restitution`` in (0, 1].

    A spring-damper contact of damping ratio z leaves with exp(-pi z / sqrt(1 - z^2)) of the approach speed.
    """
    decay = -np.log(restitution) / np.pi
    return float(decay / np.sqrt(1 + decay**2))
