"""An egg: an ellipsoid with half axes of 2.4 to 3.2 cm, 1.25 to 1.45 times as tall."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("egg")
class Egg(ObjectType):
    """An egg: an ellipsoid with half axes of 2.4 to 3.2 cm, 1.25 to 1.45 times as tall."""

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius = rng.uniform(0.024, 0.032)
        height = radius * rng.uniform(1.25, 1.45)
        return ObjectGeometry((Primitive("ellipsoid", (radius, radius, height)),), radius, height)
