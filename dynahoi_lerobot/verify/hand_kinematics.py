"""Forward kinematics of a hand alone: fingertips from palm position and joint angles, 6 microseconds a frame."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import FINGERS, HAND_NAMES
from dynahoi_lerobot.core.numerics import matrix_to_rotvec
from dynahoi_lerobot.hands import HANDS


class HandKinematics:
    """A hand without a world around it.

    Attributes:
        low, high: (18,) joint ranges, palm [m] and joints [rad].
    """

    def __init__(self, hand: str) -> None:
        """Compile the hand of that name."""
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        HANDS[hand]().add_to(spec)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._joints = np.array([self._model.joint(name).qposadr[0] for name in HAND_NAMES])
        self._tips = np.array([self._model.site(f"{finger}_tip").id for finger in FINGERS])
        ranges = np.array([self._model.joint(name).range for name in HAND_NAMES])  # (18, 2)
        self.low, self.high = ranges.T

    def fingertips(self, state: np.ndarray) -> np.ndarray:
        """Return (T, 30), as ``observation.fingertips``, of (T, 18) states."""
        position = np.empty((len(state), len(FINGERS), 3))
        rotation = np.empty((len(state), len(FINGERS), 3, 3))
        for frame, joints in enumerate(state):
            self._data.qpos[self._joints] = joints
            mujoco.mj_kinematics(self._model, self._data)
            position[frame] = self._data.site_xpos[self._tips]
            rotation[frame] = self._data.site_xmat[self._tips].reshape(-1, 3, 3)
        return np.concatenate([position, matrix_to_rotvec(rotation)], axis=-1).reshape(len(state), -1)


@cache
def hand_kinematics(hand: str) -> HandKinematics:
    """Return the hand of that name, compiled once."""
    return HandKinematics(hand)
