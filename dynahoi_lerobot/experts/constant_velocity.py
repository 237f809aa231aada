"""A privileged baseline: the target's true position and velocity, extrapolated along a straight line."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.experts.approach import EXTRAPOLATED_FRAMES, approach
from dynahoi_lerobot.experts.base import EXPERTS, SingleWorldExpert, WorldView
from dynahoi_lerobot.foundation.conventions import CONTROL_DT


@EXPERTS.register("constant_velocity")
class ConstantVelocity(SingleWorldExpert):
    """Perfect perception without a model of the motion; it plans anew in every frame, at the class's full speed."""

    name = "constant_velocity"

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        ahead_s = (world.control.latency_frames + np.arange(EXTRAPOLATED_FRAMES + 1))[:, None] * CONTROL_DT
        return approach(world, world.target_pos_w + ahead_s * world.target_velocity_w, world.control.palm_speed_m_s)
