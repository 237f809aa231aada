"""Kinds of target motion, one file per category; a class with ``@MOTIONS.register`` can be played
by its name.
"""

from dynahoi_lerobot.motions import (  # noqa: F401 - they register the motions
    circular_arc,
    hybrid,
    impact_response,
    inclined_rolling,
    pendulum,
    projectile,
    simple_harmonic,
    straight_line,
)
from dynahoi_lerobot.motions.base import (
    CATEGORIES,
    MOTIONS,
    Draw,
    Motion,
    PhysicalMotion,
    PrescribedMotion,
    Retimed,
)

__all__ = [
    "CATEGORIES",
    "MOTIONS",
    "Draw",
    "Motion",
    "PhysicalMotion",
    "PrescribedMotion",
    "Retimed",
]
