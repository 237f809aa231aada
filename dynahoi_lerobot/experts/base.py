"""What experts and privileged baselines share: the registry, and going somewhere in time with closing fingers."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.agent import Expert, WorldState
from dynahoi_lerobot.control_class import ControlClass
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import (
    CONTROL_DT,
    FINGER_DOF,
    HAND_DOF,
    LOCALIZATION_RADIUS_M,
    PALM_DOF,
)
from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.hands import HANDS

EXPERTS: Registry[type[Expert]] = Registry("expert", "dynahoi_lerobot.experts")

CLOSING_FRAMES = 8
"""Fingers close over at most this many frames."""
SPARE_FRAMES = 2
"""Fingers are closed this long before the target is within reach of them."""
CLOSED_EARLY_M = 0.0005
"""Contact is expected this much before the localisation radius, or a rounding error would catch the hand open."""
HORIZON_FRAMES = 60
"""How far baselines without the target's path extrapolate it."""


@dataclass(frozen=True, eq=False)
class WorldView:
    """What one world's hand must know at one frame.

    Attributes:
        spec: the episode.
        state: (18,) where the hand will be when a command given now takes effect: palm centre [m], world, and joints
            [rad].
        frame: of the episode, now.
        due_frame: the frame at which the command takes effect.
        target_pos_w: (3,) position of the target now [m].
        target_velocity_w: (3,) its linear velocity now [m/s].
        localized: the target has been localised.
        attempt: from 1.
        control: limits and latency.
    """

    spec: EpisodeSpec
    state: np.ndarray
    frame: int
    due_frame: int
    target_pos_w: np.ndarray
    target_velocity_w: np.ndarray
    localized: bool
    attempt: int
    control: ControlClass


class SingleWorldExpert(Expert):
    """An expert that looks at one world at a time."""

    @abstractmethod
    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world: palm centre [m], world, and joint angles [rad]."""

    def act(self, world: WorldState) -> np.ndarray:
        """Return (N, 18) commands; worlds without an episode get zeros."""
        commands = np.zeros((len(world.specs), HAND_DOF))
        for i, spec in enumerate(world.specs):
            if spec is not None:
                commands[i] = self.command(_view(world, i, spec))
        return commands


def _view(world: WorldState, i: int, spec: EpisodeSpec) -> WorldView:
    """World ``i``; until a command takes effect in the control phase it is void, so plan for the first one that does."""
    return WorldView(
        spec=spec,
        state=world.state_when_due[i],
        frame=int(world.frame[i]),
        due_frame=max(int(world.frame[i]) + world.control.latency_frames, spec.window_frames),
        target_pos_w=world.target_pose[i, :3],
        target_velocity_w=world.target_velocity[i, :3],
        localized=bool(world.localized[i]),
        attempt=int(world.attempt[i]),
        control=world.control,
    )


def reach(world: WorldView, path_w: np.ndarray, speed_m_s: float) -> np.ndarray:
    """Return (18,) the command of a hand that goes straight to the earliest point of a path that it can reach in time.

    A function of the state: a hand that was disturbed, or missed, goes on from where it is. It arrives no sooner than
    its fingers can be closed, and closes them by time to go. A hand that can reach no point goes to the last.

    Args:
        world: the hand and its limits.
        path_w: (K, 3) where the target is expected [m], world, at each frame from ``world.due_frame`` on; K > 1.
        speed_m_s: at which the palm goes, at most.
    """
    palm, joints, closed = world.state[:PALM_DOF], world.state[PALM_DOF:], closed_joints(world.spec)
    if world.localized:
        return np.concatenate([palm, closed])
    arrival = _earliest_arrival(world, path_w, speed_m_s)
    towards = path_w[arrival] - palm
    step_m = speed_m_s * CONTROL_DT
    step = towards * min(1.0 / arrival, step_m / max(float(np.linalg.norm(towards)), 1e-12))
    progress = (np.arange(arrival + 1) / arrival)[:, None]
    contact = first_contact(palm + progress * towards, path_w[: arrival + 1])
    return np.concatenate([palm + step, _closing(joints, closed, contact - SPARE_FRAMES)])


def _earliest_arrival(world: WorldView, path_w: np.ndarray, speed_m_s: float) -> int:
    """Return the first frame from ``world.due_frame``, at least 1, at which the hand can be there and closed."""
    frames = np.arange(1, len(path_w))
    turn_rad = np.abs(closed_joints(world.spec) - world.state[PALM_DOF:]).max()
    closed = frames * world.control.joint_speed_rad_s * CONTROL_DT >= turn_rad
    distance = np.linalg.norm(path_w[1:] - world.state[:PALM_DOF], axis=1)
    possible = closed & (distance <= speed_m_s * CONTROL_DT * frames)
    return int(possible.argmax()) + 1 if possible.any() else len(path_w) - 1


def _closing(joints: np.ndarray, closed: np.ndarray, frames_left: int) -> np.ndarray:
    """Return (15,) the next joint angles [rad] of fingers that must be closed in so many frames."""
    if frames_left > CLOSING_FRAMES:
        return joints
    return joints + (closed - joints) / max(frames_left, 1)


def closed_joints(spec: EpisodeSpec) -> np.ndarray:
    """Return (15,) the joint angles [rad] that close the hand around the episode's object."""
    return HANDS[spec.hand]().reference_joints(spec.target.grasp_radius_m)


def first_contact(reach_path: np.ndarray, target_path: np.ndarray) -> int:
    """Return the first frame at which two paths (K, 3) [m] come within the localisation radius, or the last frame.

    Paths are followed at five points a frame, so that a fast target is not missed.
    """
    fine = np.arange(0, len(reach_path) - 1 + 1e-9, 0.2)
    frames = np.arange(len(reach_path))
    gap = [np.interp(fine, frames, (reach_path - target_path)[:, axis]) for axis in range(3)]
    inside = np.flatnonzero(np.linalg.norm(gap, axis=0) < LOCALIZATION_RADIUS_M + CLOSED_EARLY_M)
    steps = int(np.ceil(fine[inside[0]])) if inside.size else len(reach_path) - 1
    return max(steps, 1)


def open_hand() -> np.ndarray:
    """Return (15,) zeros [rad]: the open hand."""
    return np.zeros(FINGER_DOF)


def reference_grasp(spec: EpisodeSpec) -> np.ndarray:
    return closed_joints(spec)
