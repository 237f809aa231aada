"""Held out: two balls of radius 2 to 2.8 cm on a bar."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectKind, Primitive, TargetShape


@OBJECTS.register("dumbbell")
class Dumbbell(ObjectKind):
    """Held out: two balls of radius 2 to 2.8 cm on a bar."""

    held_out = True

    @classmethod
    def shape(cls, rng: np.random.Generator) -> TargetShape:
        """Draw the geometry [m]."""
        radius, half = rng.uniform(0.02, 0.028), rng.uniform(0.025, 0.04)
        bar = Primitive("capsule", (0.4 * radius, half))
        ends = [Primitive("sphere", (radius,), (0.0, 0.0, z)) for z in (-half, half)]
        return TargetShape((bar, *ends), radius, half + radius)
