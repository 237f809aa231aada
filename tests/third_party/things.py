"""An object of somebody else, which has more primitives than any of the core's."""

import numpy as np

from dynahoi_lerobot.objects import ObjectGeometry, Primitive, object_type

SPIKES = 10
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
"""How many half-sizes each shape has."""


@object_type("caltrop")
def caltrop(rng: np.random.Generator) -> ObjectGeometry:
    """Ten spikes of every shape there is, 1 to 1.2 cm long, all around the center."""
    size = rng.uniform(0.005, 0.006)
    angles = [2 * np.pi * number / SPIKES for number in range(SPIKES)]
    spikes = [
        Primitive(
            shape,
            (size,) * n,
            (0.02 * float(np.cos(angle)), 0.02 * float(np.sin(angle)), 0.01 * (level - 2)),
        )
        for level, (shape, n) in enumerate(SIZES.items())
        for angle in angles
    ]
    return ObjectGeometry(tuple(spikes), 0.025, 0.02 + 2 * size)
