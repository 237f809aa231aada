"""From commands at 20 Hz to servo set-points at 500 Hz, within the limits of the hand."""

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, HAND_DOF, HAND_NAMES, PALM_DOF, SUBSTEPS

ROUNDING = 1e-5
"""Relative excess that counts as rounding: replaying a stored, clipped command must not clip it again."""


def _shortened(step: np.ndarray, length: np.ndarray, farthest: float) -> np.ndarray:
    """Scale steps that are longer than ``farthest``; rounding to single precision makes none too long."""
    return np.where(length > farthest * (1 + ROUNDING), step * (farthest / np.maximum(length, farthest)), step)


class Servo:
    """Ramps each command linearly over its frame, with velocity feed-forward.

    Attributes:
        low, high: (18,) least and greatest position of the palm along each slide [m], world, and joint angles [rad].

    A position servo kp (u - q) - kv q' lags behind a moving set-point by kv / kp times its speed, and a joint that is
    damped itself by its damping / kp more; adding that to u makes the joint arrive at the command exactly at the end
    of the frame.
    """

    def __init__(
        self, model: mujoco.MjModel, palm_speed_m_s: float, joint_speed_rad_s: float, *, by_axis: bool = False
    ) -> None:
        """Read gains and joint ranges of the 18 actuated joints from ``model``.

        Args:
            model: with the hand.
            palm_speed_m_s: greatest speed of the palm [m/s].
            joint_speed_rad_s: greatest speed of each joint [rad/s].
            by_axis: the palm's limit holds for each axis of the gantry by itself instead of the norm of its velocity.
        """
        joints = [model.joint(name).id for name in HAND_NAMES]
        self.low, self.high = model.jnt_range[joints].T.copy()
        damping = model.dof_damping[model.jnt_dofadr[joints]] - model.actuator_biasprm[:HAND_DOF, 2]
        self._lead_s = damping / model.actuator_gainprm[:HAND_DOF, 0]
        self._farthest_m, self._farthest_rad = palm_speed_m_s * CONTROL_DT, joint_speed_rad_s * CONTROL_DT
        self._by_axis = by_axis

    def within_reach(self, command: np.ndarray, previous: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Return (n, 18) commands towards ``command`` that a hand at ``previous`` can reach within one frame.

        A palm that cannot get there keeps its direction, unless its limit holds ``by_axis``.

        Args:
            command: (n, 18) palm positions [m] and joint angles [rad].
            previous: (n, 18) where the hands are.
            origin: (n, 18) from what both are counted: the homes' positions [m], world, and zero for joints.
        """
        step = command - previous
        palm, joints = step[:, :PALM_DOF], step[:, PALM_DOF:]
        length = np.abs(palm) if self._by_axis else np.linalg.norm(palm, axis=1, keepdims=True)
        palm = _shortened(palm, length, self._farthest_m)
        joints = _shortened(joints, np.abs(joints), self._farthest_rad)
        cut = np.concatenate([palm, joints], axis=1)
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
