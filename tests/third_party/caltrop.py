"""An object with more primitives of each shape than any of the core's."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects import ObjectGeometry, Primitive, object_type

SPIKES = 10
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
"""How many half-sizes each shape has."""


@object_type("caltrop")
def caltrop(rng: np.random.Generator) -> ObjectGeometry:
    """Ten spikes of every shape there is, 1 to 1.2 cm long, all around the centre."""
    size = rng.uniform(0.005, 0.006)
    spikes = [_spike(shape, number, size) for shape in SIZES for number in range(SPIKES)]
    return ObjectGeometry(tuple(spikes), 0.025, 0.02 + 2 * size)


def _spike(shape: str, number: int, size: float) -> Primitive:
    angle = 2 * np.pi * number / SPIKES
    height = 0.01 * (list(SIZES).index(shape) - 2)
    return Primitive(shape, (size,) * SIZES[shape], (0.02 * float(np.cos(angle)), 0.02 * float(np.sin(angle)), height))
