"""Simple harmonic motion, oscillating up and down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.geometry import Vector
from dynahoi_lerobot.motions.harmonic import HarmonicMotion


@MOTIONS.register("vertical")
@dataclass(frozen=True)
class Vertical(HarmonicMotion):
    """Harmonic along z."""

    name: ClassVar[str] = "vertical"
    phrase: ClassVar[str] = "oscillating up and down"
    axis: ClassVar[Vector] = (0.0, 0.0, 1.0)
