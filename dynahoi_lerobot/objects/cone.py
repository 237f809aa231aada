"""A cone of base radius 2.8 to 3.8 cm, six tapering slices high."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("cone")
class Cone(ObjectType):
    """A cone of base radius 2.8 to 3.8 cm, six tapering slices high."""

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius, slice_half = rng.uniform(0.028, 0.038), rng.uniform(0.005, 0.0075)
        widths = radius * (1 - np.arange(6) / 6)
        middles = (2 * np.arange(6) + 1) * slice_half  # above the base
        center = float(np.average(middles, weights=widths**2))
        slices = tuple(
            Primitive("cylinder", (float(width), slice_half), (0.0, 0.0, float(middle - center)))
            for width, middle in zip(widths, middles, strict=True)
        )
        return ObjectGeometry(slices, 0.75 * radius, center)
