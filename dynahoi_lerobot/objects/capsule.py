"""A capsule of radius 2.2 to 3.2 cm and half length 1.5 to 3.5 cm between the caps."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("capsule")
class Capsule(ObjectType):
    """A capsule of radius 2.2 to 3.2 cm and half length 1.5 to 3.5 cm between the caps."""

    rolls = True

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius, half = rng.uniform(0.022, 0.032), rng.uniform(0.015, 0.035)
        return ObjectGeometry((Primitive("capsule", (radius, half)),), radius, radius + half, radius)
