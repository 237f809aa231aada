"""A ball of radius 2.5 to 4 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectKind, Primitive, TargetShape


@OBJECTS.register("ball")
class Ball(ObjectKind):
    """A ball of radius 2.5 to 4 cm."""

    rolls = True
    slides = True

    @classmethod
    def shape(cls, rng: np.random.Generator) -> TargetShape:
        """Draw the geometry [m]."""
        radius = rng.uniform(0.025, 0.04)
        return TargetShape((Primitive("sphere", (radius,)),), radius, radius, radius)
