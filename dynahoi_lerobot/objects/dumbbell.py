"""Two balls of radius 2 to 2.8 cm on a bar."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("dumbbell")
class Dumbbell(ObjectType):
    """Two balls of radius 2 to 2.8 cm on a bar."""

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius, half = rng.uniform(0.02, 0.028), rng.uniform(0.025, 0.04)
        bar = Primitive("capsule", (0.4 * radius, half))
        ends = [Primitive("sphere", (radius,), (0.0, 0.0, z)) for z in (-half, half)]
        return ObjectGeometry((bar, *ends), radius, half + radius)
