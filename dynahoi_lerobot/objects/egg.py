"""An egg: an ellipsoid with half axes of 2.4 to 3.2 cm, 1.25 to 1.45 times as tall."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectKind, Primitive, TargetShape


@OBJECTS.register("egg")
class Egg(ObjectKind):
    """An egg: an ellipsoid with half axes of 2.4 to 3.2 cm, 1.25 to 1.45 times as tall."""

    @classmethod
    def shape(cls, rng: np.random.Generator) -> TargetShape:
        """Draw the geometry [m]."""
        radius = rng.uniform(0.024, 0.032)
        height = radius * rng.uniform(1.25, 1.45)
        return TargetShape((Primitive("ellipsoid", (radius, radius, height)),), radius, height)
