"""Base class of impacts: an object slides on a level table of low friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dynahoi_lerobot.motions.base import PhysicalMotion
from dynahoi_lerobot.motions.geometry import Vector, as_vector, heading, yaw_quat
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.objects import OBJECTS, TargetObject

TABLE_HALF_M = (1.1, 0.9, 0.02)


@dataclass(frozen=True)
class TabletopMotion(PhysicalMotion):
    """An impact on a level table of low friction.

    Attributes:
        contact: centre of the target at the impact [m].
        yaw_rad: horizontal direction of what moves before the impact, the striker or the target.
        speed_m_s: its speed at the impact.
        impact_s: time of the impact [s]; earlier by less than a millisecond for a ball that begins to roll.
        restitution: rebound speed over approach speed.
        friction: sliding friction of the table.
    """

    contact: Vector
    yaw_rad: float
    speed_m_s: float
    impact_s: float
    restitution: float
    friction: float
    category: ClassVar[str] = "impact_response"
    max_frames: ClassVar[int] = 79
    max_approach_frames: ClassVar[int] = 20

    @classmethod
    def objects(cls) -> list[str]:
        """Return the names of those that slide."""
        return [name for name, kind in OBJECTS.items() if kind.slides]

    def table(self, target: TargetObject) -> Box:
        """Return the table under the target."""
        top = np.asarray(self.contact) - [0.0, 0.0, target.rest_height_m + TABLE_HALF_M[2]]
        return Box(as_vector(top), TABLE_HALF_M, yaw_quat(self.yaw_rad), friction=self.friction)

    def direction(self) -> np.ndarray:
        """Return the (3,) unit vector along ``yaw_rad``, world."""
        return np.asarray(heading(self.yaw_rad))


def reach_m(target: TargetObject) -> float:
    """Return how far an upright target extends from its centre along its x axis [m].

    Impacts are along that axis, so that boxes are hit in the middle of a face.
    """
    extents = []
    for primitive in target.primitives:
        size = np.asarray(primitive.half_size)
        along = size[0] if primitive.shape == "box" else size[0] + abs(primitive.pos[0])
        extents.append(along)
    return float(max(extents))
