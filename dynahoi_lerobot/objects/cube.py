"""A cube with edges of 4.5 to 7 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectKind, Primitive, TargetShape


@OBJECTS.register("cube")
class Cube(ObjectKind):
    """A cube with edges of 4.5 to 7 cm."""

    slides = True

    @classmethod
    def shape(cls, rng: np.random.Generator) -> TargetShape:
        """Draw the geometry [m]."""
        half = rng.uniform(0.0225, 0.035)
        return TargetShape((Primitive("box", (half, half, half)),), half, half)
