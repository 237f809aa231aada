"""Simple harmonic motion, oscillating from side to side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.geometry import Vector
from dynahoi_lerobot.motions.harmonic import HarmonicMotion


@MOTIONS.register("lateral")
@dataclass(frozen=True)
class Lateral(HarmonicMotion):
    """Harmonic along y, across the view."""

    name: ClassVar[str] = "lateral"
    phrase: ClassVar[str] = "oscillating from side to side"
    axis: ClassVar[Vector] = (0.0, 1.0, 0.0)
