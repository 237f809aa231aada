"""The paper's expert: go straight to where the target will be, at constant speed, and close the fingers in time."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.experts.approach import approach
from dynahoi_lerobot.experts.base import EXPERTS, SingleWorldExpert, WorldView

SPEED_M_S = 1.0
"""Faster than this it does not go, where it may."""


@EXPERTS.register("intercept")
class Intercept(SingleWorldExpert):
    """A constant-speed straight approach to the earliest point of the target's path that the hand can reach.

    Appendix "Data collection" lets the expert predict an intercept and wait for a planar tolerance; this one knows the
    untouched target's path and plans anew in every frame from where the hand will be when the command takes effect. So
    it labels any state, also after a disturbance or a miss, and arrives together with the target: no wait is needed.
    """

    name = "intercept"

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        path_w = world.spec.oracle_path[min(world.due_frame, world.spec.horizon_frames - 2) :]
        return approach(world, path_w, min(SPEED_M_S, world.control.palm_speed_m_s))
