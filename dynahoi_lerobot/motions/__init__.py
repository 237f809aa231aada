"""Kinds of target motion, one file each; a new file with ``@MOTIONS.register`` can be played by its name."""

from dynahoi_lerobot.motions.base import CATEGORIES, MOTIONS, Motion, PhysicalMotion, PrescribedMotion
from dynahoi_lerobot.motions.draw import Draw

__all__ = ["CATEGORIES", "MOTIONS", "Draw", "Motion", "PhysicalMotion", "PrescribedMotion"]
