"""The base class of objects: a few solids of sampled size, with a mass, a friction and the ways they may move."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.objects.primitives import Primitive, solid_inertia

OBJECTS: Registry[type[ObjectType]] = Registry("object", "dynahoi_lerobot.objects")

MASS_RANGE_KG = (0.04, 0.18)
FRICTION_RANGE = (0.6, 1.1)
TORSIONAL_FRICTION_M, ROLLING_FRICTION_M = 0.002, 0.0002
"""Torsional and rolling friction of contacts: greatest torque over normal force [m]."""


@dataclass(frozen=True)
class TargetObject:
    """One sampled object, as the scene shows and simulates it.

    Attributes:
        name: its registered name.
        primitives: its solids, in the object's frame: origin at the centre of mass, z along the axis of symmetry.
        mass_kg: its mass.
        inertia: principal moments of inertia [kg m^2], aligned with the object's frame.
        friction: sliding friction coefficient.
        grasp_radius_m: half of the width that the fingers close around.
        rest_height_m: height of the centre when it stands on a surface.
        roll_radius_m: radius it rolls on, 0 if it does not roll.
    """

    name: str
    primitives: tuple[Primitive, ...]
    mass_kg: float
    inertia: tuple[float, float, float]
    friction: float
    grasp_radius_m: float
    rest_height_m: float
    roll_radius_m: float


class ObjectType(ABC):
    """How objects of one name are sampled.

    Class attributes:
        rolls: they roll on their side without wobbling, so they can go down a ramp.
        slides: they stay flat when pushed along a surface.
    """

    rolls: ClassVar[bool] = False
    slides: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions of the solids [m]."""

    @classmethod
    def sample(cls, name: str, rng: np.random.Generator) -> TargetObject:
        """Draw one object.

        Args:
            name: its registered name.
            rng: source of geometry, mass (0.04 to 0.18 kg) and friction (0.6 to 1.1), in this order.
        """
        geometry = cls.sample_geometry(rng)
        mass = rng.uniform(*MASS_RANGE_KG)
        return TargetObject(
            name=name,
            primitives=geometry.primitives,
            mass_kg=mass,
            inertia=solid_inertia(geometry.primitives, mass),
            friction=rng.uniform(*FRICTION_RANGE),
            grasp_radius_m=geometry.grasp_radius_m,
            rest_height_m=geometry.rest_height_m,
            roll_radius_m=geometry.roll_radius_m if cls.rolls else 0.0,
        )


@dataclass(frozen=True)
class ObjectGeometry:
    """The solids of one sampled object and the lengths that follow from them; ``TargetObject`` describes the fields."""

    primitives: tuple[Primitive, ...]
    grasp_radius_m: float
    rest_height_m: float
    roll_radius_m: float = 0.0
