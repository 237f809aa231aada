"""Privileged controllers, one file each: demonstrators and baselines that see the simulator's
state.
"""

from dynahoi_lerobot.experts import (  # noqa: F401 - they register the experts
    baselines,
    intercept,
    match,
)
from dynahoi_lerobot.experts.base import EXPERTS

__all__ = ["EXPERTS"]
