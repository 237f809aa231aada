"""Catching by contact: meet the target at its own velocity, close on contact, hold the grip, brake, lift, shake."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from dynahoi_lerobot.core.agent import Meeting
from dynahoi_lerobot.core.conventions import CONTROL_DT, FINGER_DOF, GANTRY_SPEED_M_S, PALM_DOF
from dynahoi_lerobot.core.numerics import norm, product, sin
from dynahoi_lerobot.core.rules import ControlClass
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts.base import EXPERTS, SingleWorldExpert, WorldView

PALM_FACE_M = -0.036
"""The palm's surface along x, from the palm centre."""
SEAT_Y_M, SEAT_Z_M = 0.0, 0.004
"""Where the centre of a held target is along y and z, from the palm centre."""
CLOSING_SPEED_M_S = 0.3
"""At contact the palm moves this much faster than the target, along the palm's normal."""
FOLLOW_FRAMES = 2
"""After contact the palm stays this long on the path of the untouched target, while the fingers close."""
LEAD_FRAMES = 1
"""The fingers begin to close this long before contact."""
FAST_RAD, GRIP_RAD = 0.5, 0.2
"""How far a joint is commanded beyond its angle: while closing, and while holding (0.2 rad give 0.6 N m)."""
BRAKE_FRAMES = 10
LIFT_M = 0.06
"""Rise of the palm while it brakes."""
SHAKE_M, SHAKE_FRAMES, LONGEST_SHAKE_FRAMES = 0.015, 12, 120
"""Amplitude along y and z, period, and length of the shake."""
MAX_PALM_ACCELERATION_M_S2 = 60.0
"""Half of what the servos' 120 N give."""
SHORTEST_APPROACH_FRAMES, LONGEST_SEARCH_FRAMES = 4, 60
NEAR_M, BEHIND_MARGIN_M = 0.2, 0.004
"""A target nearer to its seat than the first may be behind the palm's surface by the second at most."""
RETRY_SPACING = 3
"""Each further attempt moves this many places down the ranking of moments."""


@dataclass(frozen=True, eq=False)
class Catch:
    """A planned catch.

    Attributes:
        palm_w: (K, 3) palm centre at every frame from control start [m], world.
        start_frame: of ``palm_w[0]``.
        contact_frame: when the target reaches the palm.
    """

    palm_w: np.ndarray
    start_frame: int
    contact_frame: int

    @property
    def meeting(self) -> Meeting:
        """Where the palm is when the target reaches it."""
        return Meeting(self.palm_w[self.contact_frame - self.start_frame], self.contact_frame)

    def command(self, frame: int, state: np.ndarray) -> np.ndarray:
        """Return (18,) the command that takes effect at ``frame``: where the hand should be one frame later.

        A hand that was disturbed before contact returns to the path evenly until contact.

        Args:
            frame: of the episode.
            state: (18,) where the hand is then: palm centre [m], world, and joint angles [rad].
        """
        now, ahead = np.clip([frame - self.start_frame, frame + 1 - self.start_frame], 0, len(self.palm_w) - 1)
        left = self.contact_frame - max(frame, self.start_frame)
        strayed = (state[:PALM_DOF] - self.palm_w[now]) * max(left - 1, 0) / max(left, 1)
        since = frame + 1 - self.contact_frame
        if since < -LEAD_FRAMES:
            closing = np.zeros(FINGER_DOF)
        else:
            closing = state[PALM_DOF:] + (FAST_RAD if since <= FOLLOW_FRAMES else GRIP_RAD)
        return np.concatenate([self.palm_w[ahead] + strayed, closing])


@EXPERTS.register("match")
class Match(SingleWorldExpert):
    """Velocity-matched interception with a power grasp, for the capture rule ``contact``.

    A plan follows from the episode and the attempt alone, and is kept while the episode is played.
    """

    retries = 3

    def __init__(self) -> None:
        self._catches: WeakKeyDictionary[EpisodeSpec, dict[int, Catch]] = WeakKeyDictionary()

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        return self._catch(world.spec, world.attempt).command(world.due_frame, world.state)

    def first_meeting(self, spec: EpisodeSpec, control: ControlClass, attempt: int) -> Meeting:
        """Return the meeting of the attempt's plan."""
        return self._catch(spec, attempt).meeting

    def _catch(self, spec: EpisodeSpec, attempt: int) -> Catch:
        catches = self._catches.setdefault(spec, {})
        if attempt not in catches:
            catches[attempt] = plan_catch(spec, attempt)
        return catches[attempt]


def plan_catch(spec: EpisodeSpec, attempt: int = 1) -> Catch:
    """Return the catch for an attempt (from 1): the first is planned for the easiest moment, others for harder ones.

    The first command takes effect when control starts.
    """
    seat = np.array([PALM_FACE_M + spec.target.grasp_radius_m, SEAT_Y_M, SEAT_Z_M])
    goal = spec.oracle_path - seat  # (F, 3) where the palm must be for the target to sit in it
    moments = _ranked_moments(spec, goal)
    moment = moments[min((attempt - 1) * RETRY_SPACING, len(moments) - 1)]
    approach = _approach(spec, goal, moment)
    path = _carry_away(np.concatenate([approach, goal[moment + 1 : moment + 1 + FOLLOW_FRAMES]]))
    return Catch(path, spec.window_frames, moment)


def _ranked_moments(spec: EpisodeSpec, goal: np.ndarray) -> list[int]:
    """Return frames at which the target can be caught, easiest first."""
    first = spec.window_frames + SHORTEST_APPROACH_FRAMES
    last = min(len(goal) - 2 - FOLLOW_FRAMES - BRAKE_FRAMES - SHAKE_FRAMES, spec.window_frames + LONGEST_SEARCH_FRAMES)
    moments = range(first, max(last, first) + 1)
    return sorted(moments, key=lambda moment: _difficulty(spec, goal, moment))


def _difficulty(spec: EpisodeSpec, goal: np.ndarray, moment: int) -> float:
    """Return a cost: over the hand's limits, target behind the palm, fast, jerky, far from the intercept."""
    palm = _approach(spec, goal, moment)
    velocity = np.diff(palm, axis=0) / CONTROL_DT
    peak_m_s2 = np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() / CONTROL_DT
    excess = max(np.abs(velocity).max() / GANTRY_SPEED_M_S - 1, 0) + max(peak_m_s2 / MAX_PALM_ACCELERATION_M_S2 - 1, 0)
    offset = goal[spec.window_frames : moment + 1] - palm  # (K, 3) of the target from its seat
    near = np.linalg.norm(offset, axis=1) < NEAR_M
    behind = np.maximum(-offset[near, 0] - BEHIND_MARGIN_M, 0.0).sum()
    speed = norm(_velocity(goal, moment))
    carried = goal[moment : moment + FOLLOW_FRAMES + 1]
    carried_m_s2 = np.linalg.norm(np.diff(carried, n=2, axis=0), axis=1).max() / CONTROL_DT**2
    frames_off = abs(moment - spec.intercept_frame)
    return float(100 * (excess + behind) + speed + 0.02 * carried_m_s2 + 0.05 * frames_off)


def _approach(spec: EpisodeSpec, goal: np.ndarray, moment: int) -> np.ndarray:
    """Return the palm's (K, 3) path [m], world, from rest at home to the target's motion at ``moment``."""
    before, at, after = goal[moment - 1 : moment + 2]
    velocity = _velocity(goal, moment) + [CLOSING_SPEED_M_S, 0.0, 0.0]
    velocity = np.clip(velocity, -GANTRY_SPEED_M_S, GANTRY_SPEED_M_S)  # a limit of each axis of the gantry
    acceleration = (after - 2 * at + before) / CONTROL_DT**2
    still = np.zeros(3)
    return _quintic((spec.home_pos_w, still, still), (at, velocity, acceleration), moment - spec.window_frames)


def _velocity(path: np.ndarray, frame: int) -> np.ndarray:
    """Return (3,) the velocity [m/s] of a path (F, 3) at a frame."""
    return (path[frame + 1] - path[frame - 1]) / (2 * CONTROL_DT)


def _carry_away(path: np.ndarray) -> np.ndarray:
    """Return the (K, 3) path of a palm that holds a target, followed by braking with a lift and a gentle shake [m]."""
    velocity, still = (path[-1] - path[-2]) / CONTROL_DT, np.zeros(3)
    rest = path[-1] + velocity * BRAKE_FRAMES * CONTROL_DT / 2 + [0.0, 0.0, LIFT_M]
    braking = _quintic((path[-1], velocity, still), (rest, still, still), BRAKE_FRAMES)
    phase = 2 * np.pi * np.arange(1, LONGEST_SHAKE_FRAMES)[:, None] / SHAKE_FRAMES
    shaking = rest + SHAKE_M * sin(phase) * [0.0, 1.0, 1.0]
    return np.concatenate([path, braking[1:], shaking])


State = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Position [m], velocity [m/s] and acceleration [m/s^2], (3,) each."""


def _quintic(start: State, end: State, frames: int) -> np.ndarray:
    """Return (frames + 1, 3) positions [m] on the fifth-order polynomial that joins two states."""
    scale = np.array([1.0, frames * CONTROL_DT, (frames * CONTROL_DT) ** 2])[:, None]
    boundary = np.concatenate([np.stack(start) * scale, np.stack(end) * scale])
    progress = np.linspace(0.0, 1.0, frames + 1)
    return product(np.vander(progress, 6, increasing=True), product(QUINTIC, boundary))


QUINTIC = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.0],
        [-10.0, -6.0, -1.5, 10.0, -4.0, 0.5],
        [15.0, 8.0, 1.5, -15.0, 7.0, -1.0],
        [-6.0, -3.0, -0.5, 6.0, -3.0, 0.5],
    ]
)
"""(6, 6) from position, velocity and acceleration at both ends of [0, 1] to the coefficients of the polynomial."""
