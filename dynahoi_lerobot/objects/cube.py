"""A cube with edges of 4.5 to 7 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("cube")
class Cube(ObjectType):
    """A cube with edges of 4.5 to 7 cm."""

    slides = True

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        half = rng.uniform(0.0225, 0.035)
        return ObjectGeometry((Primitive("box", (half, half, half)),), half, half)
