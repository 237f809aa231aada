"""Hands, one file each; all have the same 18 degrees of freedom."""

from dynahoi_lerobot.hands import capsule, robot  # noqa: F401 - they register the hands
from dynahoi_lerobot.hands.base import HANDS, Hand

__all__ = ["HANDS", "Hand"]
