"""A can: a cylinder of radius 2.5 to 3.5 cm and half height 3 to 5 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("cylinder")
class Cylinder(ObjectType):
    """A can: a cylinder of radius 2.5 to 3.5 cm and half height 3 to 5 cm."""

    rolls = True
    slides = True

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius, half = rng.uniform(0.025, 0.035), rng.uniform(0.03, 0.05)
        return ObjectGeometry((Primitive("cylinder", (radius, half)),), radius, half, radius)
