"""A ring of eight segments, 2.8 to 3.6 cm from the centre to the middle of its 0.8 cm tube."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType
from dynahoi_lerobot.objects.primitives import Primitive


@OBJECTS.register("ring")
class Ring(ObjectType):
    """A ring of eight segments, 2.8 to 3.6 cm from the centre to the middle of its 0.8 cm tube."""

    slides = True

    @classmethod
    def sample_geometry(cls, rng: np.random.Generator) -> ObjectGeometry:
        """Draw sizes and positions [m]."""
        radius, tube = rng.uniform(0.028, 0.036), 0.008
        half = radius * np.tan(np.pi / 8)
        return ObjectGeometry(tuple(_segment(i, radius, tube, half) for i in range(8)), radius + tube, tube)


def _segment(index: int, radius: float, tube: float, half: float) -> Primitive:
    """Return one capsule, lying along the tangent of the circle."""
    angle = index * np.pi / 4
    pos = (float(radius * np.cos(angle)), float(radius * np.sin(angle)), 0.0)
    # the capsule's own z axis is laid into the plane, then turned to the tangent
    quat = (0.5**0.5, float(-(0.5**0.5) * np.cos(angle)), float(-(0.5**0.5) * np.sin(angle)), 0.0)
    return Primitive("capsule", (tube, float(half)), pos, quat)
