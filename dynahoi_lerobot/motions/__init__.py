"""Kinds of target motion, one file each. A new file with ``@MOTIONS.register`` is a new motion everywhere."""

from dynahoi_lerobot.motions.base import (
    CATEGORIES,
    MOTIONS,
    Draw,
    Motion,
    PhysicalMotion,
    PrescribedMotion,
    benchmark_motions,
)

__all__ = [
    "CATEGORIES",
    "MOTIONS",
    "Draw",
    "Motion",
    "PhysicalMotion",
    "PrescribedMotion",
    "benchmark_motions",
]
