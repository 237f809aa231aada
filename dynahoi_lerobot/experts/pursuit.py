"""A privileged baseline without prediction: it goes to where the target is."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.experts.approach import EXTRAPOLATED_FRAMES, approach
from dynahoi_lerobot.experts.base import EXPERTS, SingleWorldExpert, WorldView


@EXPERTS.register("pursuit")
class Pursuit(SingleWorldExpert):
    """Goes at full speed to the target's true position of this frame; what it scores needs no prediction."""

    name = "pursuit"

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        return approach(world, np.tile(world.target_pos_w, (EXTRAPOLATED_FRAMES + 1, 1)), world.control.palm_speed_m_s)
