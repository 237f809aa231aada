"""A privileged baseline: the target's true position, velocity and acceleration, extrapolated along a parabola."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.experts.approach import EXTRAPOLATED_FRAMES, approach
from dynahoi_lerobot.experts.base import EXPERTS, SingleWorldExpert, WorldView
from dynahoi_lerobot.foundation.conventions import CONTROL_DT


@EXPERTS.register("constant_acceleration")
class ConstantAcceleration(SingleWorldExpert):
    """Perfect perception and a second-order model of the motion; it plans anew in every frame, at full speed."""

    name = "constant_acceleration"

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        ahead_s = (world.control.latency_frames + np.arange(EXTRAPOLATED_FRAMES + 1))[:, None] * CONTROL_DT
        moved = ahead_s * world.target_velocity_w + ahead_s**2 / 2 * _acceleration(world)
        return approach(world, world.target_pos_w + moved, world.control.palm_speed_m_s)


def _acceleration(world: WorldView) -> np.ndarray:
    """Return (3,) the mean acceleration [m/s^2] over the last two frames of the untouched target."""
    frame = min(max(world.frame, 2), len(world.spec.oracle_path) - 1)
    before, last, now = world.spec.oracle_path[frame - 2 : frame + 1]
    return (now - 2 * last + before) / CONTROL_DT**2
