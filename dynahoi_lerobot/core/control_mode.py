"""What an action is: the paper's 18 numbers, or four of a grasp, which the world maps to 18."""

import numpy as np

from dynahoi_lerobot.core.conventions import HAND_NAMES, PALM_DOF

JOINTS = "joints"
GRASP = "grasp"
CONTROL_MODES = {
    JOINTS: HAND_NAMES,
    GRASP: ("palm_dx", "palm_dy", "palm_dz", "closing"),
}
"""Names of the numbers of an action by mode. ``joints``: where the palm should be [m], home frame,
and joint angles [rad]. ``grasp``: the palm's displacement from where it is now [m], along the same
axes, and how far the hand is closed, from 0, open, to 1, its closed pose."""


def from_grasp(
    action: np.ndarray, state: np.ndarray, open_joints: np.ndarray, closed_joints: np.ndarray
) -> np.ndarray:
    """Return (N, 18) commands of (N, 4) grasp actions.

    Args:
        action: displacements [m] and closing numbers, which are cut to 0 to 1.
        state: (N, 18) observed state of the hands: palm [m], home frame, and joints [rad].
        open_joints: (15,) of the open hand [rad].
        closed_joints: (15,) of the closed hand [rad].
    """
    closing = np.clip(action[:, PALM_DOF:], 0.0, 1.0)  # (N, 1)
    palm = state[:, :PALM_DOF] + action[:, :PALM_DOF]
    return np.concatenate([palm, open_joints + closing * (closed_joints - open_joints)], axis=1)


def to_grasp(
    command: np.ndarray, state: np.ndarray, open_joints: np.ndarray, closed_joints: np.ndarray
) -> np.ndarray:
    """Return (N, 4) the grasp actions nearest to (N, 18) commands; the inverse of ``from_grasp``,
    same arguments.
    """
    way = closed_joints - open_joints
    closing = np.clip((command[:, PALM_DOF:] - open_joints) @ way / (way @ way), 0.0, 1.0)
    return np.column_stack([command[:, :PALM_DOF] - state[:, :PALM_DOF], closing])
