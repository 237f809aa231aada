"""What experts share: the registry, and how a hand goes somewhere in a straight line and closes on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.agent import Expert
from dynahoi_lerobot.foundation.conventions import LOCALIZATION_RADIUS_M, PALM_DOF
from dynahoi_lerobot.foundation.registry import Registry

EXPERTS: Registry[type[Expert]] = Registry("expert", "dynahoi_lerobot.experts")

CLOSING_FRAMES = 8
"""Fingers close within at most this many frames."""
CLOSED_EARLY_M = 0.0005
"""Fingers are closed this much before the localisation radius, or a rounding error would catch them open."""


@dataclass(frozen=True, eq=False)
class Reach:
    """A straight constant-speed approach that ends with closed fingers.

    Attributes:
        goal_pos_w: (3,) palm centre when it arrives [m], world.
        start_frame, arrival_frame: when.
        closed_frame: first frame with closed fingers.
        closed_joints: (15,) joint angles [rad].
    """

    goal_pos_w: np.ndarray
    start_frame: int
    arrival_frame: int
    closed_frame: int
    closed_joints: np.ndarray

    def command(self, frame: int, state: np.ndarray) -> np.ndarray:
        """Return (18,) the command of ``frame``, as a ``MotionPlan`` does.

        A hand that strayed goes straight on from where it is, at the speed that still arrives in time; so what it
        does depends on where it is and where it must be, and on nothing that an observer cannot see.
        """
        ahead, palm_pos_w = frame + 1, state[:PALM_DOF]
        left = max(self.arrival_frame - max(frame, self.start_frame), 1)
        begin = max(self.start_frame, self.closed_frame - CLOSING_FRAMES)
        joints = _ramp(ahead, begin, self.closed_frame) * self.closed_joints
        return np.concatenate([palm_pos_w + (self.goal_pos_w - palm_pos_w) / left, joints])


def first_contact_frame(reach_path: np.ndarray, target_path: np.ndarray, start_frame: int) -> int:
    """Return the first frame at which two paths (K, 3) come within the localisation radius, or the last frame.

    Paths are followed at five points a frame, so that a fast target is not missed.
    """
    fine = np.arange(0, len(reach_path) - 1 + 1e-9, 0.2)
    frames = np.arange(len(reach_path))
    gap = [np.interp(fine, frames, (reach_path - target_path)[:, axis]) for axis in range(3)]
    inside = np.flatnonzero(np.linalg.norm(gap, axis=0) < LOCALIZATION_RADIUS_M + CLOSED_EARLY_M)
    steps = int(np.ceil(fine[inside[0]])) if inside.size else len(reach_path) - 1
    return start_frame + max(steps, 1)


def _ramp(value: int, low: int, high: int) -> float:
    return float(np.clip((value - low) / max(high - low, 1), 0.0, 1.0))
