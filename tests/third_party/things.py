"""A motion and an object of somebody else: its name sorts before all of the core's, it has more
primitives than any.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from dynahoi_lerobot.motions import MOTIONS, Draw, PrescribedMotion
from dynahoi_lerobot.motions.launch import Vector
from dynahoi_lerobot.objects import ObjectGeometry, Primitive, object_type


@MOTIONS.register("a_drift")
@dataclass(frozen=True)
class Drift(PrescribedMotion):
    """Slow uniform motion along y.

    Attributes:
        center: where it is at ``center_s`` [m].
        center_s: [s].
        speed_m_s: along y.
    """

    center: Vector
    center_s: float
    speed_m_s: float
    category: ClassVar[str] = "straight_line"
    phrase: ClassVar[str] = "drifting to the side"

    @classmethod
    def sample(cls, draw: Draw) -> Self:
        return cls(draw.meeting_point(), draw.intercept_s, draw.uniform(0.05, 0.2) * draw.sign())

    def position(self, time_s: np.ndarray) -> np.ndarray:
        return np.asarray(self.center) + np.outer(
            time_s - self.center_s, [0.0, self.speed_m_s, 0.0]
        )


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
