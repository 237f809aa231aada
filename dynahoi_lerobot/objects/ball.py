"""A ball of radius 2.5 to 4 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("ball")
class Ball(ObjectType):
    """A ball of radius 2.5 to 4 cm."""

    rolls = True
    slides = True

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius = rng.uniform(0.025, 0.04)
        return ObjectGeometry((Primitive("sphere", (radius,)),), radius, radius, radius)
