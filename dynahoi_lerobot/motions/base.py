"""The base classes of motions: a prescribed path with exact derivatives, or an initial condition for real dynamics.

The paper names three tiers and eight categories (Section 3.2); the 22 kinds and all their ranges are ours.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import asdict
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.motions.draw import Draw
from dynahoi_lerobot.motions.launch import Launch
from dynahoi_lerobot.objects import OBJECTS, TargetObject

MOTIONS: Registry[type[Motion]] = Registry("motion", "dynahoi_lerobot.motions")

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
    """A kind of motion; an instance is one motion with its parameters (a frozen dataclass, SI units, world frame).

    Class attributes:
        name: the registered name.
        category: one of ``CATEGORIES``.
        phrase: how an instruction describes the motion, after "the object that is".
        max_frames: longest recording in which the motion is still under way [frames].
        max_approach_frames: latest intercept [frames after the control start]; motions that end soon are met early.
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
    def objects(cls) -> list[str]:
        """Return the names of the objects that can move this way: all registered ones, unless a kind overrides it."""
        return OBJECTS.names()

    def launch(self, target: TargetObject) -> Launch:
        """Return the initial condition of ``target`` and the fixtures around it; a closed form has neither."""
        return Launch((0.0, 0.0, 0.0))

    def parameters(self) -> str:
        """Return the parameters as JSON, SI units."""
        return json.dumps(asdict(self), sort_keys=True)  # type: ignore[call-overload]


class PrescribedMotion(Motion):
    """A path in closed form. The simulation drives the target along it, with the force its acceleration requires."""

    @abstractmethod
    def position(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) position [m], world, at (K,) times [s]."""

    @abstractmethod
    def velocity(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) velocity [m/s], world, the exact derivative of ``position``."""

    @abstractmethod
    def acceleration(self, time_s: np.ndarray) -> np.ndarray:
        """Return (K, 3) acceleration [m/s^2], world, the exact derivative of ``velocity``."""


class PhysicalMotion(Motion):
    """An initial condition; MuJoCo simulates where the target goes from there."""

    @abstractmethod
    def launch(self, target: TargetObject) -> Launch:
        """Return the initial condition of ``target`` and the fixtures around it."""
