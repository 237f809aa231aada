"""A bottle: a body of radius 2.4 to 3.2 cm, a neck half as wide and a cap."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("bottle")
class Bottle(ObjectType):
    """A bottle: a body of radius 2.4 to 3.2 cm, a neck half as wide and a cap."""

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius, half = rng.uniform(0.024, 0.032), rng.uniform(0.035, 0.05)
        neck_radius, neck_half = 0.45 * radius, 0.35 * half
        shift = 0.12 * half  # puts the centre of mass at the origin, within a few per cent
        body = Primitive("cylinder", (radius, half), (0.0, 0.0, -shift))
        neck = Primitive("cylinder", (neck_radius, neck_half), (0.0, 0.0, half - shift + neck_half))
        cap = Primitive("sphere", (1.15 * neck_radius,), (0.0, 0.0, half - shift + 2 * neck_half))
        return ObjectGeometry((body, neck, cap), radius, half + shift)
