"""A disc: a flat cylinder of radius 3 to 4.2 cm and half height 0.8 to 1.2 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("disc")
class Disc(ObjectType):
    """A disc: a flat cylinder of radius 3 to 4.2 cm and half height 0.8 to 1.2 cm."""

    slides = True

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius, half = rng.uniform(0.03, 0.042), rng.uniform(0.008, 0.012)
        return ObjectGeometry((Primitive("cylinder", (radius, half)),), radius, half)
