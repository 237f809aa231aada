"""Kinds of target motion, one file per category; a class with ``@MOTIONS.register`` can be played
by its name.
"""

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
