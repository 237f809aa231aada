"""Hands that catch, one file per embodiment; all have the same 18 degrees of freedom."""

from dynahoi_lerobot.hands.base import HANDS, Hand

__all__ = ["HANDS", "Hand"]
