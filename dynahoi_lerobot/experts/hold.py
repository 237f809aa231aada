"""The floor: a hand that never moves."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.agent import Expert, WorldState
from dynahoi_lerobot.experts.base import EXPERTS


@EXPERTS.register("hold")
class Hold(Expert):
    """Commands the pose it is in."""

    name = "hold"
    privileged = False

    def act(self, world: WorldState) -> np.ndarray:
        """Return (N, 18), the measured state."""
        return world.observation.state.astype(np.float64)
