"""The paper's expert: go straight to where the target will be, at constant speed, and close the fingers in time."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.agent import WorldState
from dynahoi_lerobot.experts.approach import approach, earliest_arrival
from dynahoi_lerobot.experts.base import EXPERTS, SingleWorldExpert, WorldView, views

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
        return approach(world, _path_ahead(world), _speed(world))

    def arrivals(self, state: WorldState) -> np.ndarray:
        """Return (N,) int, in how many frames from now it means to meet each target; 0 without an episode."""
        frames = np.zeros(len(state.specs), int)
        for i, world in views(state):
            frames[i] = world.due_frame - world.frame + earliest_arrival(world, _path_ahead(world), _speed(world))
        return frames


def _path_ahead(world: WorldView) -> np.ndarray:
    """(K, 3) the untouched target's path [m], world, from the frame on at which a command takes effect; K > 1."""
    return world.spec.oracle_path[min(world.due_frame, world.spec.horizon_frames - 2) :]


def _speed(world: WorldView) -> float:
    return min(SPEED_M_S, world.control.palm_speed_m_s)
