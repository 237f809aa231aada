"""Privileged controllers, one file each: demonstrators and baselines that see the simulator's
state.
"""

from dynahoi_lerobot.experts.base import EXPERTS

__all__ = ["EXPERTS"]
