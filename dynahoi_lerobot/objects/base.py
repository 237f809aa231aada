"""What an object is: a few geometric primitives of sampled size, a mass, a friction, and how it may move."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dynahoi_lerobot.foundation.registry import Registry

OBJECTS: Registry[type[ObjectKind]] = Registry("object", "dynahoi_lerobot.objects")

IDENTITY_QUAT = (1.0, 0.0, 0.0, 0.0)
MASS_RANGE_KG = (0.04, 0.18)
FRICTION_RANGE = (0.6, 1.1)
TORSIONAL_FRICTION_M, ROLLING_FRICTION_M = 0.002, 0.0002
"""Resistance of contacts to turning and to rolling: torque over normal force [m]."""


@dataclass(frozen=True)
class Primitive:
    """One solid of an object, in the object's frame.

    Attributes:
        shape: ``sphere``, ``capsule``, ``cylinder``, ``ellipsoid`` or ``box``.
        size: MuJoCo half-sizes [m]: (radius,), (radius, half length), (half extents x, y, z).
        pos: centre [m].
        quat: orientation, wxyz.
    """

    shape: str
    size: tuple[float, ...]
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat: tuple[float, float, float, float] = IDENTITY_QUAT

    @property
    def half_size(self) -> tuple[float, float, float]:
        """``size`` padded with zeros to three numbers [m]."""
        x, y, z, *_ = (*self.size, 0.0, 0.0)
        return (x, y, z)


@dataclass(frozen=True)
class TargetObject:
    """One sampled object: a row of numbers that the scene can show and simulate.

    Attributes:
        name: the registered kind.
        primitives: its solids, in the object's frame (origin at the centre of mass, z its axis of symmetry).
        mass_kg: mass.
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


class ObjectKind(ABC):
    """A kind of object: how one is drawn at random.

    Class attributes:
        rolls: it rolls on its side without wobbling, so it can go down a ramp.
        slides: it stays flat when pushed along a surface.
        held_out: it never appears in training; only ``ood_object`` uses it.
    """

    rolls: ClassVar[bool] = False
    slides: ClassVar[bool] = False
    held_out: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def shape(cls, rng: np.random.Generator) -> TargetShape:
        """Draw the geometry."""

    @classmethod
    def sample(cls, name: str, rng: np.random.Generator) -> TargetObject:
        """Draw one object: its shape, then mass [kg] and friction, uniform in the ranges above."""
        shape = cls.shape(rng)
        mass = rng.uniform(*MASS_RANGE_KG)
        return TargetObject(
            name=name,
            primitives=shape.primitives,
            mass_kg=mass,
            inertia=solid_inertia(shape.primitives, mass),
            friction=rng.uniform(*FRICTION_RANGE),
            grasp_radius_m=shape.grasp_radius_m,
            rest_height_m=shape.rest_height_m,
            roll_radius_m=shape.roll_radius_m if cls.rolls else 0.0,
        )


@dataclass(frozen=True)
class TargetShape:
    """The geometry of one sampled object; see ``TargetObject`` for the fields."""

    primitives: tuple[Primitive, ...]
    grasp_radius_m: float
    rest_height_m: float
    roll_radius_m: float = 0.0


def solid_inertia(primitives: tuple[Primitive, ...], mass_kg: float) -> tuple[float, float, float]:
    """Return principal moments [kg m^2] of solids of one density with ``mass_kg`` in total.

    Primitives are aligned with the object's axes or rotated by right angles, as all ours are; the products
    of inertia of the others (a ring's segments) cancel by symmetry.
    """
    volumes = np.array([_volume(p) for p in primitives])
    masses = mass_kg * volumes / volumes.sum()
    total = np.zeros(3)
    for primitive, mass in zip(primitives, masses, strict=True):
        rotation = _rotation(primitive.quat)
        own = np.diag(rotation @ np.diag(mass * _unit_inertia(primitive)) @ rotation.T)
        offset = np.asarray(primitive.pos)
        total += own + mass * (offset @ offset - offset**2)
    return (float(total[0]), float(total[1]), float(total[2]))


def _volume(primitive: Primitive) -> float:
    a, b, c = primitive.half_size
    return {
        "sphere": 4 / 3 * np.pi * a**3,
        "capsule": np.pi * a**2 * (2 * b) + 4 / 3 * np.pi * a**3,
        "cylinder": np.pi * a**2 * 2 * b,
        "ellipsoid": 4 / 3 * np.pi * a * b * c,
        "box": 8 * a * b * c,
    }[primitive.shape]


def _unit_inertia(primitive: Primitive) -> np.ndarray:
    """(3,) moments of inertia per unit mass [m^2] about the primitive's own axes."""
    a, b, c = primitive.half_size
    if primitive.shape == "sphere":
        return np.full(3, 0.4 * a**2)
    if primitive.shape == "ellipsoid":
        return 0.2 * np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    if primitive.shape == "box":
        return np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2]) / 3
    if primitive.shape == "cylinder":
        across = (3 * a**2 + 4 * b**2) / 12
        return np.array([across, across, a**2 / 2])
    return _capsule_unit_inertia(a, b)


def _capsule_unit_inertia(radius: float, half: float) -> np.ndarray:
    """A cylinder of half length ``half`` and two hemispherical caps."""
    barrel, caps = np.pi * radius**2 * 2 * half, 4 / 3 * np.pi * radius**3
    mb, mc = barrel / (barrel + caps), caps / (barrel + caps)
    axial = mb * radius**2 / 2 + mc * 0.4 * radius**2
    across = mb * (3 * radius**2 + 4 * half**2) / 12 + mc * (0.4 * radius**2 + half**2 + 0.75 * half * radius)
    return np.array([across, across, axial])


def _rotation(quat: tuple[float, ...]) -> np.ndarray:
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
