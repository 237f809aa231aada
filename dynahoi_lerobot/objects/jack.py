"""Held out: three crossed bars of half length 3 to 4 cm."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.base import OBJECTS, ObjectKind, Primitive, TargetShape


@OBJECTS.register("jack")
class Jack(ObjectKind):
    """Held out: three crossed bars of half length 3 to 4 cm."""

    held_out = True

    @classmethod
    def shape(cls, rng: np.random.Generator) -> TargetShape:
        """Draw the geometry [m]."""
        tube, half = rng.uniform(0.009, 0.012), rng.uniform(0.03, 0.04)
        turns = ((1.0, 0.0, 0.0, 0.0), (0.5**0.5, 0.5**0.5, 0.0, 0.0), (0.5**0.5, 0.0, 0.5**0.5, 0.0))
        bars = tuple(Primitive("capsule", (tube, half), (0.0, 0.0, 0.0), turn) for turn in turns)
        return TargetShape(bars, 0.8 * half, half + tube)
