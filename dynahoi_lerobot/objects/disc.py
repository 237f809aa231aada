"""A disc: a flat cylinder of radius 3 to 4.2 cm and half height 0.8 to 1.2 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectKind, Primitive, TargetShape


@OBJECTS.register("disc")
class Disc(ObjectKind):
    """A disc: a flat cylinder of radius 3 to 4.2 cm and half height 0.8 to 1.2 cm."""

    slides = True

    @classmethod
    def shape(cls, rng: np.random.Generator) -> TargetShape:
        """Draw the geometry [m]."""
        radius, half = rng.uniform(0.03, 0.042), rng.uniform(0.008, 0.012)
        return TargetShape((Primitive("cylinder", (radius, half)),), radius, half)
