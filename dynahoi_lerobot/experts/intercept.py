"""The paper's expert: go straight to where the target will be, at constant speed, and close the fingers in time."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.agent import Meeting, WorldState
from dynahoi_lerobot.control_class import ControlClass
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts.approach import approach, earliest_arrival
from dynahoi_lerobot.experts.base import EXPERTS, Teacher, WorldView, views

SPEED_M_S = 1.0
"""Faster than this it does not go, where it may."""


@EXPERTS.register("intercept")
class Intercept(Teacher):
    """A constant-speed straight approach to the earliest point of the target's path that the hand can reach.

    Appendix "Data collection" lets the expert predict an intercept and wait for a planar tolerance; this one knows the
    untouched target's path and plans anew in every frame from where the hand will be when the command takes effect. So
    it labels any state, also after a disturbance or a miss, and arrives together with the target: no wait is needed.
    """

    name = "intercept"

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        return approach(world, _path_from(world.spec, world.due_frame), _speed(world.control))

    def arrivals(self, state: WorldState) -> np.ndarray:
        """See `Teacher.arrivals`."""
        frames = np.zeros(len(state.specs), int)
        for i, world in views(state):
            path_w, closed = _path_from(world.spec, world.due_frame), world.spec.reference_joints
            arrival = earliest_arrival(world.state, closed, path_w, _speed(world.control), world.control)
            frames[i] = world.due_frame - world.frame + arrival
        return frames

    def first_meeting(self, spec: EpisodeSpec, control: ControlClass, attempt: int) -> Meeting:
        """Return the meeting of its first plan, from the open hand at home."""
        path_w, waiting = _path_from(spec, spec.window_frames), np.concatenate([spec.home_pos_w, spec.open_joints])
        arrival = earliest_arrival(waiting, spec.reference_joints, path_w, _speed(control), control)
        return Meeting(path_w[arrival], spec.window_frames + arrival)


def _path_from(spec: EpisodeSpec, frame: int) -> np.ndarray:
    """(K, 3) where the untouched target is [m], world, from ``frame`` on; K > 1."""
    return spec.oracle_path[min(frame, spec.horizon_frames - 2) :]


def _speed(control: ControlClass) -> float:
    return min(SPEED_M_S, control.palm_speed_m_s)
