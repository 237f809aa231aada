"""A mug: a cup of radius 2.8 to 3.6 cm with a handle."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("cup")
class Cup(ObjectType):
    """A mug: a cup of radius 2.8 to 3.6 cm with a handle."""

    slides = True

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius, half = rng.uniform(0.028, 0.036), rng.uniform(0.03, 0.042)
        turn = (0.7071067811865476, 0.7071067811865476, 0.0, 0.0)
        body = Primitive("cylinder", (radius, half))
        bar = Primitive("capsule", (0.005, 0.5 * half), (0.0, radius + 0.016, 0.0))
        upper = Primitive("capsule", (0.005, 0.01), (0.0, radius + 0.008, 0.5 * half), turn)
        lower = Primitive("capsule", (0.005, 0.01), (0.0, radius + 0.008, -0.5 * half), turn)
        return ObjectGeometry((body, bar, upper, lower), radius, half)
