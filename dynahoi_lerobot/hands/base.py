"""The base class of hands: a palm on three slides, fifteen flexion joints, five fingertip sites and a camera."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import EGO_VIEW, FINGER_DOF
from dynahoi_lerobot.core.numerics import norm
from dynahoi_lerobot.core.registry import Registry

PALM_SITE = "palm_center"
PALM_BODY = "palm"
EGO_CAMERA = EGO_VIEW
HAND_GEOM_PREFIX = "hand_"
"""Names that every hand uses, by which the scene finds its parts; fingertip sites are ``<finger>_tip``."""

SKIN_GEOM_PREFIX, SLEEVE_GEOM = "skin_", "sleeve"
"""Names of geoms that are only drawn: they collide with nothing and have no mass."""
SHOWN_GROUP, SKIN_GROUP, HIDDEN_GROUP = 0, 1, 4
"""Groups of geoms that are drawn, that are drawn and nothing else, and that are not drawn."""


CLOSED_RADIUS_M = 0.0295
"""Closed around this radius, a hand passes the two-sided test of the grasp for 97 % of the targets."""


def camera_quat(forward: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return (4,) quaternion wxyz of an upright camera, whose -z points along ``forward`` (3,), of any length."""
    ahead = np.asarray(forward, float) / norm(forward)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= norm(right)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.column_stack([right, np.cross(right, ahead), -ahead]).ravel())
    return quat


class Hand(ABC):
    """A hand, which adds its bodies, actuators, sites and camera to a model under construction.

    It must keep to these names and frames: body ``palm`` hangs on joints ``palm_x, palm_y, palm_z``; the fifteen joints
    are named as in ``conventions.JOINT_NAMES``; site ``palm_center`` lies in the middle of the grasp volume, at the
    origin of ``palm`` at zero slide positions; sites ``<finger>_tip`` sit on the pads with z along the finger;
    camera ``ego`` is fixed to the palm; each actuator drives one joint, in the order of ``conventions.HAND_NAMES``.
    """

    @abstractmethod
    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add the hand to ``spec``."""

    def open_joints(self) -> np.ndarray:
        """Return (15,) joint angles [rad] of the open hand, in which it waits: straight fingers by default."""
        return np.zeros(FINGER_DOF)

    @abstractmethod
    def reference_joints(self, grasp_radius_m: float) -> np.ndarray:
        """Return (15,) joint angles [rad] of the reference grasp around an object of that radius [m]."""

    def closed_joints(self) -> np.ndarray:
        """Return (15,) joint angles [rad] of the closed hand, one pose for all objects."""
        return self.reference_joints(CLOSED_RADIUS_M)


HANDS: Registry[type[Hand]] = Registry("hand", "dynahoi_lerobot.hands")
