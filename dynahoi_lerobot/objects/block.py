"""A brick: half extents of 3 to 4.5, 2 to 2.8 and 1.5 to 2.2 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("block")
class Block(ObjectType):
    """A brick: half extents of 3 to 4.5, 2 to 2.8 and 1.5 to 2.2 cm."""

    slides = True

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        size = (rng.uniform(0.03, 0.045), rng.uniform(0.02, 0.028), rng.uniform(0.015, 0.022))
        return ObjectGeometry((Primitive("box", size),), size[1], size[2])
