"""Three crossed bars of half length 3 to 4 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("jack")
class Jack(ObjectType):
    """Three crossed bars of half length 3 to 4 cm."""

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        tube, half = rng.uniform(0.009, 0.012), rng.uniform(0.03, 0.04)
        turns = ((1.0, 0.0, 0.0, 0.0), (0.5**0.5, 0.5**0.5, 0.0, 0.0), (0.5**0.5, 0.0, 0.5**0.5, 0.0))
        bars = tuple(Primitive("capsule", (tube, half), (0.0, 0.0, 0.0), turn) for turn in turns)
        return ObjectGeometry(bars, 0.8 * half, half + tube)
