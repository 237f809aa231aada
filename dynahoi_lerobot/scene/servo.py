"""From commands at 20 Hz to servo set-points at 500 Hz, within the limits of the hand."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, HAND_DOF, PALM_DOF, SUBSTEPS

ROUNDING = 1e-5
"""Relative excess that counts as rounding: replaying a stored, clipped command must not clip it again."""


@dataclass(frozen=True)
class SpeedLimits:
    """Speed limits of the hand within one frame.

    Attributes:
        palm_speed_m_s: of the palm [m/s].
        joint_speed_rad_s: of each joint [rad/s].
        by_axis: the palm's limit holds for each axis of the gantry by itself instead of the norm of its velocity.
    """

    palm_speed_m_s: float
    joint_speed_rad_s: float
    by_axis: bool = False

    def cut(self, step: np.ndarray) -> np.ndarray:
        """Return (n, 18) the steps [m, rad] of one frame, cut to the limits; the palm's keeps its direction."""
        palm, joints = step[:, :PALM_DOF], step[:, PALM_DOF:]
        farthest_m, farthest_rad = self.palm_speed_m_s * CONTROL_DT, self.joint_speed_rad_s * CONTROL_DT
        length = np.abs(palm) if self.by_axis else np.linalg.norm(palm, axis=1, keepdims=True)
        return np.concatenate(
            [_shortened(palm, length, farthest_m), _shortened(joints, np.abs(joints), farthest_rad)], axis=1
        )


def _shortened(step: np.ndarray, length: np.ndarray, farthest: float) -> np.ndarray:
    """Scale steps that are longer than ``farthest``; rounding to single precision makes none too long."""
    return np.where(length > farthest * (1 + ROUNDING), step * (farthest / np.maximum(length, farthest)), step)


class Servo:
    """Ramps each command linearly over its frame, with velocity feed-forward.

    Attributes:
        low, high: (18,) least and greatest position of the palm along each slide [m], world, and joint angles [rad].

    A position servo kp (u - q) - kv q' lags behind a moving set-point by kv / kp times its speed; adding that to u
    makes the joint arrive at the command exactly at the end of the frame.
    """

    def __init__(self, model: mujoco.MjModel, limits: SpeedLimits) -> None:
        """Read gains and joint ranges of the 18 actuated joints from ``model``, and keep to ``limits``."""
        joints = model.actuator_trnid[:HAND_DOF, 0]
        self.low, self.high = model.jnt_range[joints].T.copy()
        self._lead_s = -model.actuator_biasprm[:HAND_DOF, 2] / model.actuator_gainprm[:HAND_DOF, 0]
        self._limits = limits

    def within_reach(self, command: np.ndarray, previous: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Return (n, 18) commands towards ``command`` that a hand at ``previous`` can reach within one frame.

        Args:
            command: (n, 18) palm positions [m] and joint angles [rad].
            previous: (n, 18) where the hands are.
            origin: (n, 18) from what both are counted: the homes' positions [m], world, and zero for joints.
        """
        step = command - previous
        cut = self._limits.cut(step)
        towards = np.where(cut == step, command, previous + cut)
        return np.clip(towards, self.low - origin, self.high - origin)

    def set_points(self, command: np.ndarray, previous: np.ndarray) -> np.ndarray:
        """Return (n, 25, 18) set-points that lead from ``previous`` to ``command``, (n, 18) each."""
        change = (command - previous)[:, None]
        progress = (np.arange(SUBSTEPS) / SUBSTEPS)[:, None]  # where each joint should be when the step begins
        return previous[:, None] + progress * change + self._lead_s * change / CONTROL_DT


def check_command(command: np.ndarray, count: int, size: int = HAND_DOF) -> np.ndarray:
    """Return ``command`` as (count, size) float64.

    Raises:
        ValueError: if the shape is wrong, or a value is not a real number or not finite; the message names the world,
            the key and the value.
    """
    given = np.asarray(command)
    if given.dtype.kind not in "fiu":
        raise ValueError(f"action must hold real numbers, got dtype {given.dtype}")
    values = given.astype(np.float64)
    if values.shape != (count, size):
        raise ValueError(f"action must have shape ({count}, {size}), got {values.shape}")
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        world, dof = bad[0]
        raise ValueError(f"action of world {world} must be finite, got {values[world, dof]} at index {dof}")
    return values
