"""From commands at 20 Hz to servo set-points at 500 Hz, within the limits of the hand."""

from __future__ import annotations

import mujoco
import numpy as np

from dynahoi_lerobot.foundation.conventions import CONTROL_DT, HAND_DOF, PALM_DOF, SUBSTEPS

MAX_PALM_SPEED_M_S = 2.0
MAX_JOINT_SPEED_RAD_S = 20.0
"""A command further away than one frame at these speeds is cut short."""


class Servo:
    """Ramps each command linearly over its frame, with velocity feed-forward.

    A position servo kp (u - q) - kv q' lags behind a moving set-point by kv / kp times its speed; adding that to u
    makes the joint arrive at the command exactly at the end of the frame.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Read gains and joint ranges of the 18 actuated joints from ``model``."""
        joints = model.actuator_trnid[:HAND_DOF, 0]
        self.low, self.high = model.jnt_range[joints].T.copy()
        self._lead_s = -model.actuator_biasprm[:HAND_DOF, 2] / model.actuator_gainprm[:HAND_DOF, 0]
        speed = np.full(HAND_DOF, MAX_JOINT_SPEED_RAD_S)
        speed[:PALM_DOF] = MAX_PALM_SPEED_M_S
        self._max_step = speed * CONTROL_DT

    def clip(self, command: np.ndarray, previous: np.ndarray) -> np.ndarray:
        """Return (n, 18) commands within joint ranges and within reach of one frame from ``previous`` (n, 18)."""
        step = np.clip(command - previous, -self._max_step, self._max_step)
        return np.clip(previous + step, self.low, self.high)

    def set_points(self, command: np.ndarray, previous: np.ndarray) -> np.ndarray:
        """Return (n, 25, 18) set-points that lead from ``previous`` to ``command``, (n, 18) each."""
        change = (command - previous)[:, None]
        progress = (np.arange(SUBSTEPS) / SUBSTEPS)[:, None]  # where each joint should be when the step begins
        return previous[:, None] + progress * change + self._lead_s * change / CONTROL_DT


def check_command(command: np.ndarray, count: int) -> np.ndarray:
    """Return ``command`` as (count, 18) float64.

    Raises:
        ValueError: if the shape is wrong, or a value is not a real number or not finite; the message names the world,
            the key and the value.
    """
    given = np.asarray(command)
    if given.dtype.kind not in "fiu":
        raise ValueError(f"action must hold real numbers, got dtype {given.dtype}")
    values = given.astype(np.float64)
    if values.shape != (count, HAND_DOF):
        raise ValueError(f"action must have shape ({count}, {HAND_DOF}), got {values.shape}")
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        world, dof = bad[0]
        raise ValueError(f"action of world {world} must be finite, got {values[world, dof]} at index {dof}")
    return values
