"""What an object is: a few solids of sampled size, with a mass, a friction and the ways they may
move.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.registry import Registry
from dynahoi_lerobot.objects.primitives import Primitive, solid_inertia

MASS_RANGE_KG = (0.04, 0.18)
FRICTION_RANGE = (0.6, 1.1)


@dataclass(frozen=True)
class TargetObject:
    """One sampled object, as the scene shows and simulates it.

    Attributes:
        name: its registered name.
        primitives: its solids, in the object's frame: origin at the center of mass, z along the
            axis of symmetry.
        mass_kg: its mass.
        inertia: principal moments of inertia [kg m^2], aligned with the object's frame.
        friction: sliding friction coefficient.
        grasp_radius_m: half of the width that the fingers close around.
        rest_height_m: height of the center when it stands on a surface.
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


@dataclass(frozen=True)
class ObjectGeometry:
    """The solids of one sampled object and the lengths that follow from them; ``TargetObject``
    describes the fields.
    """

    primitives: tuple[Primitive, ...]
    grasp_radius_m: float
    rest_height_m: float
    roll_radius_m: float = 0.0


SampleGeometry = Callable[[np.random.Generator], ObjectGeometry]
"""Draws the sizes and positions of an object's solids [m]."""


class ObjectType:
    """How objects of one name are sampled; ``object_type`` makes one from a function, whose
    docstring it has.

    Attributes:
        name: the registered name.
        rolls: they roll on their side without wobbling, so they can go down a ramp.
        slides: they stay flat when pushed along a surface.
    """

    def __init__(
        self, name: str, sample_geometry: SampleGeometry, *, rolls: bool, slides: bool
    ) -> None:
        functools.update_wrapper(self, sample_geometry)  # type: ignore[arg-type]
        self.name = name
        self.rolls = rolls
        self.slides = slides
        self._sample_geometry = sample_geometry

    def sample(self, rng: np.random.Generator) -> TargetObject:
        """Draw one object: geometry, mass (0.04 to 0.18 kg) and friction (0.6 to 1.1), in this
        order.
        """
        geometry = self._sample_geometry(rng)
        mass = rng.uniform(*MASS_RANGE_KG)
        return TargetObject(
            name=self.name,
            primitives=geometry.primitives,
            mass_kg=mass,
            inertia=solid_inertia(geometry.primitives, mass),
            friction=rng.uniform(*FRICTION_RANGE),
            grasp_radius_m=geometry.grasp_radius_m,
            rest_height_m=geometry.rest_height_m,
            roll_radius_m=geometry.roll_radius_m if self.rolls else 0.0,
        )


OBJECTS: Registry[ObjectType] = Registry("object", ObjectType)


def object_type(
    name: str, *, rolls: bool = False, slides: bool = False
) -> Callable[[SampleGeometry], ObjectType]:
    """Return a decorator that registers a function of a random generator as the object ``name``.

    Args:
        name, rolls, slides: as ``ObjectType`` has them.
    """

    def decorate(sample_geometry: SampleGeometry) -> ObjectType:
        return OBJECTS.register(name)(ObjectType(name, sample_geometry, rolls=rolls, slides=slides))

    return decorate
