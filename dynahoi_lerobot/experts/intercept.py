"""The paper's expert: go straight to where the target will be, at constant speed, and close the
fingers in time.
"""

from functools import cache, lru_cache

import numpy as np

from dynahoi_lerobot.core.agent import Expert, Meeting, WorldView
from dynahoi_lerobot.core.conventions import CONTROL_DT, PALM_DOF
from dynahoi_lerobot.core.numerics import norm
from dynahoi_lerobot.core.protocols import ControlClass
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts.base import EXPERTS
from dynahoi_lerobot.hands import HANDS

CLOSING_FRAMES = 8
"""Fingers close over at most this many frames."""
CLOSED_FRAMES = 16
"""A goal has the fingers closed this long before the meeting: a learner that comes to it a little
off, or early, must not be caught open."""
GRASP_SHARES = (0.95, 1.15)
"""Least and greatest share of an object's reference rotation that a goal asks for, within what
counts as a success."""
SPARE_FRAMES = 2
"""Fingers are closed this long before the target comes within reach of them."""
CLOSED_EARLY_M = 0.0005
"""Contact is expected this much before the localization radius, or a rounding error would catch the
hand open."""
EXTRAPOLATED_FRAMES = 60
"""How far baselines that do not know the target's path extrapolate it."""
SPEED_M_S = 1.0
"""Faster than this it does not go, where it may."""


@EXPERTS.register("intercept")
class Intercept(Expert):
    """A constant-speed straight approach to the earliest point of the target's path that the hand
    can reach.

    Appendix "Data collection" lets the expert predict an intercept and wait for a planar tolerance;
    this one knows the untouched target's path and replans in every frame from where the hand will
    be when the command takes effect. So it labels any state, also after a disturbance or a miss,
    and arrives together with the target: no wait is needed.
    """

    labels_any_state = True

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        return approach(world, _path_from(world.spec, world.due_frame), _speed(world.control))

    def goal(self, world: WorldView) -> np.ndarray:
        """Return (18,) the meeting point, and fingers that close by time to go; after the catch,
        the held pose.
        """
        return meeting_goal(world, _path_from(world.spec, world.due_frame), _speed(world.control))

    def first_meeting(self, spec: EpisodeSpec, control: ControlClass) -> Meeting:
        """Return the meeting of its first plan, from the open hand at home."""
        path_w = _path_from(spec, spec.window_frames)
        waiting = np.concatenate([spec.home_pos_w, spec.open_joints])
        arrival = earliest_arrival(waiting, spec.reference_joints, path_w, _speed(control), control)
        return Meeting(path_w[arrival], spec.window_frames + arrival)


def approach(world: WorldView, path_w: np.ndarray, speed_m_s: float) -> np.ndarray:
    """Return (18,) the command of a hand that goes straight to the earliest point of a path that it
    can reach in time.

    A function of the state: a hand that was disturbed, or missed, continues from where it is. It
    arrives no sooner than its fingers can be closed, and closes them by time to go. A hand that can
    reach no point goes to the last one.

    Args:
        world: the hand and its limits.
        path_w: (K, 3) where the target is expected [m], world, at each frame from
            ``world.due_frame`` on; K > 1.
        speed_m_s: speed limit of the palm [m/s].
    """
    palm = world.state[:PALM_DOF]
    joints = world.state[PALM_DOF:]
    closed = world.spec.reference_joints
    if world.localized:
        return np.concatenate([palm, closed])
    arrival = earliest_arrival(world.state, closed, path_w, speed_m_s, world.control)
    towards = path_w[arrival] - palm
    longest_m = speed_m_s * CONTROL_DT
    step = towards * min(1.0 / arrival, longest_m / max(norm(towards), 1e-12))
    progress = (np.arange(arrival + 1) / arrival)[:, None]
    reach_m = world.localization_radius_m + CLOSED_EARLY_M
    contact = _first_contact(palm + progress * towards, path_w[: arrival + 1], reach_m)
    turn = _closing(
        closed - joints, contact - SPARE_FRAMES, world.control.joint_speed_rad_s * CONTROL_DT
    )
    return np.concatenate([palm + step, joints + turn])


def meeting_goal(world: WorldView, path_w: np.ndarray, speed_m_s: float) -> np.ndarray:
    """Return (18,) an expert's goal: the earliest point of a path in reach, and fingers closed
    well before it.

    Args:
        world, path_w, speed_m_s: see `approach`.
    """
    spec = world.spec
    closed = _closed_around(world.spec)
    if world.localized:
        return np.concatenate([world.state[:PALM_DOF], closed])
    arrival = earliest_arrival(world.state, closed, path_w, speed_m_s, world.control)
    closing = min(max((CLOSED_FRAMES + CLOSING_FRAMES - arrival) / CLOSING_FRAMES, 0.0), 1.0)
    return np.concatenate(
        [path_w[arrival], spec.open_joints + closing * (closed - spec.open_joints)]
    )


def earliest_arrival(
    state: np.ndarray,
    closed: np.ndarray,
    path_w: np.ndarray,
    speed_m_s: float,
    control: ControlClass,
) -> int:
    """Return after how many frames, at least 1, a hand can first be at the target and closed; the
    last if never.

    Args:
        state: (18,) of the hand: palm center [m], world, and joint angles [rad].
        closed: (15,) joint angles of the closed hand [rad].
        path_w: (K, 3) the target's path from now on [m], world; K > 1.
        speed_m_s: speed limit of the palm [m/s].
        control: limits of the joints.
    """
    frames = np.arange(1, len(path_w))
    turn_rad = np.abs(closed - state[PALM_DOF:]).max()
    in_time = frames * control.joint_speed_rad_s * CONTROL_DT >= turn_rad
    distance = np.linalg.norm(path_w[1:] - state[:PALM_DOF], axis=1)
    possible = in_time & (distance <= speed_m_s * CONTROL_DT * frames)
    return int(possible.argmax()) + 1 if possible.any() else len(path_w) - 1


@cache
def closed_joints(hand: str) -> np.ndarray:
    """Return (15,) joint angles [rad] of a closed hand."""
    return HANDS[hand].closed_joints()


@lru_cache(maxsize=256)  # asked in every frame, of the episodes being played
def _closed_around(spec: EpisodeSpec) -> np.ndarray:
    """(15,) joint angles of the closed hand [rad], the same for all objects but the thinnest and
    the thickest.
    """
    turn = spec.reference_joints - spec.open_joints
    least, most = np.sort([spec.open_joints + share * turn for share in GRASP_SHARES], axis=0)
    return np.clip(closed_joints(spec.hand), least, most)


def _path_from(spec: EpisodeSpec, frame: int) -> np.ndarray:
    """(K, 3) where the untouched target is [m], world, from ``frame`` on; K > 1."""
    return spec.target_path_w[min(frame, spec.horizon_frames - 2) :]


def _speed(control: ControlClass) -> float:
    return min(SPEED_M_S, control.palm_speed_m_s)


def _closing(missing: np.ndarray, frames_left: int, farthest_rad: float) -> np.ndarray:
    """Return (15,) how far joints turn next [rad] that have ``missing`` (15,) to go in so many
    frames.
    """
    if frames_left > CLOSING_FRAMES:
        return np.zeros_like(missing)
    return np.clip(missing / max(frames_left, 1), -farthest_rad, farthest_rad)


def _first_contact(palm_w: np.ndarray, target_w: np.ndarray, reach_m: float) -> int:
    """Return the first frame at which two paths (K, 3) [m] come within ``reach_m``, or the last
    frame.

    Paths are followed at five points a frame, so that a fast target is not missed.
    """
    frames = np.arange(len(palm_w))
    fine = np.arange(0, len(palm_w) - 1 + 1e-9, 0.2)
    gap = [np.interp(fine, frames, (palm_w - target_w)[:, axis]) for axis in range(3)]
    inside = np.flatnonzero(np.linalg.norm(gap, axis=0) < reach_m)
    return max(int(np.ceil(fine[inside[0]])), 1) if inside.size else len(palm_w) - 1
