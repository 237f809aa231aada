"""Simple harmonic motion, oscillating towards and away from the hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.geometry import Vector
from dynahoi_lerobot.motions.harmonic import HarmonicMotion


@MOTIONS.register("depth")
@dataclass(frozen=True)
class Depth(HarmonicMotion):
    """Harmonic along x, where the palm faces."""

    name: ClassVar[str] = "depth"
    phrase: ClassVar[str] = "oscillating towards and away from the hand"
    axis: ClassVar[Vector] = (1.0, 0.0, 0.0)
