"""The base class of hands: a palm on three slides, fifteen flexion joints, five fingertip sites and
a camera.
"""

import functools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import (
    EGO_VIEW,
    FINGER_DOF,
    FINGERS,
    GANTRY_RANGE_M,
    JOINT_NAMES,
    PALM_AXES,
)
from dynahoi_lerobot.core.numerics import cos, norm, sin
from dynahoi_lerobot.core.registry import Registry

PALM_SITE = "palm_center"
PALM_BODY = "palm"
HAND_GEOM_PREFIX = "hand_"
"""Names that every hand uses, by which the scene finds its parts; fingertip sites are
``<finger>_tip``."""

SKIN_GEOM_PREFIX, SLEEVE_GEOM = "skin_", "sleeve"
"""Names of geoms that are only drawn: they collide with nothing and have no mass."""
SHOWN_GROUP, SKIN_GROUP, HIDDEN_GROUP = 0, 1, 4
"""Groups of geoms that are drawn, that are drawn and nothing else, and that are not drawn."""

PALM_MASS_KG = 0.8
PALM_FORCE_N = 120.0
PALM_BANDWIDTH_RAD_S = 150.0
FINGER_BANDWIDTH_RAD_S = 120.0
IDLE_RANGE_RAD = -0.05
"""Joints may open a little further than at rest: an idle limit would be a constraint in every
physics step."""

CAMERA_POS = (-0.15, 0.03, 0.21)
CAMERA_PITCH_RAD = 0.45
CAMERA_FOVY_DEG = 84.0
"""The camera looks over the back of the hand, along +x and down, and sees past the thumb into the
grasp volume."""

CLOSED_RADIUS_M = 0.0295
"""Closed around this radius, a hand passes the two-sided test of the grasp for 97 % of the
targets."""


def camera_quat(forward: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return (4,) quaternion wxyz of an upright camera, whose -z points along ``forward`` (3,), of
    any length.
    """
    ahead = np.asarray(forward, float) / norm(forward)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= norm(right)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.column_stack([right, np.cross(right, ahead), -ahead]).ravel())
    return quat


class Hand(ABC):
    """A hand, which adds its bodies, actuators, sites and camera to a model under construction.

    It must keep to these names and frames: body ``palm`` hangs on joints ``palm_x, palm_y,
    palm_z``; the fifteen joints are named as in ``conventions.JOINT_NAMES``; site ``palm_center``
    lies in the middle of the grasp volume, at the origin of ``palm`` at zero slide positions; sites
    ``<finger>_tip`` sit on the pads with z along the finger; camera ``ego`` is fixed to the palm;
    each joint has an actuator of its name, in the order of ``conventions.HAND_NAMES``.

    Attributes:
        summary: one sentence, for ``dynahoi list hands``.
        full_closure_rad: (3,) joint angles of each finger when the hand is fully closed [rad].
    """

    summary: str
    full_closure_rad: Mapping[str, tuple[float, float, float]]

    @abstractmethod
    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add the hand to ``spec``."""

    def open_joints(self) -> np.ndarray:
        """Return (15,) joint angles [rad] of the open hand, in which it waits: straight fingers by
        default.
        """
        return np.zeros(FINGER_DOF)

    def reference_joints(self, grasp_radius_m: float) -> np.ndarray:
        """Return (15,) joint angles [rad] of the reference grasp around an object of that radius
        [m].

        Each fingertip is ``grasp_radius_m`` away from the middle of the grasp volume, so larger
        objects give smaller rotations (Figure 3b of the paper). Fingers that cannot come that close
        stop at full closure.
        """
        closure, distance = self._closure_table
        joints = [
            np.asarray(self.full_closure_rad[finger])
            * np.interp(-grasp_radius_m, -from_middle, closure)
            for finger, from_middle in zip(FINGERS, distance, strict=True)
        ]
        return np.concatenate(joints)

    def fingertips(self, closure: np.ndarray) -> np.ndarray:
        """Return (K, 5, 3) positions of the fingertips [m], palm frame, at fractions (K,) of full
        closure.
        """
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        self.add_to(spec)
        model = spec.compile()
        data = mujoco.MjData(model)
        full = np.concatenate([self.full_closure_rad[finger] for finger in FINGERS])
        joints = [int(model.joint(name).qposadr[0]) for name in JOINT_NAMES]
        tips = np.zeros((len(closure), len(FINGERS), 3))
        for k, share in enumerate(closure):
            data.qpos[joints] = share * full
            mujoco.mj_kinematics(model, data)
            palm_pos_w = data.site(PALM_SITE).xpos
            tips[k] = [data.site(f"{finger}_tip").xpos - palm_pos_w for finger in FINGERS]
        return tips

    def closed_joints(self) -> np.ndarray:
        """Return (15,) joint angles [rad] of the closed hand, one pose for all objects."""
        return self.reference_joints(CLOSED_RADIUS_M)

    @functools.cached_property
    def _closure_table(self) -> tuple[np.ndarray, np.ndarray]:
        """Closure fractions (K,) and, per finger, the tip's distance (5, K) [m] from the middle of
        the grasp volume.

        That is the axis through the palm center, along z: fingers close around an upright object.
        The thumb's is the distance to the palm center itself.
        """
        closure = np.linspace(0.0, 1.0, 101)
        distance = [
            [
                norm(tip if finger == "thumb" else tip[:2])
                for finger, tip in zip(FINGERS, tips, strict=True)
            ]
            for tips in self.fingertips(closure)
        ]
        return closure, np.minimum.accumulate(np.transpose(distance), axis=1)


HANDS: Registry[Hand] = Registry("hand", Hand)


def add_palm(spec: mujoco.MjSpec, fingers_kg: float) -> mujoco.MjsBody:
    """Add the palm's body, slides, servos, site and camera, without any geom; return the body.

    Args:
        spec: the model under construction.
        fingers_kg: mass of the fingers, which the servos move together with the palm.
    """
    palm = spec.worldbody.add_body(name=PALM_BODY, gravcomp=1.0)
    palm.explicitinertial = True
    palm.mass = PALM_MASS_KG
    palm.inertia = (8e-4,) * 3
    palm.ipos = (0.0, 0.0, 0.0)
    for axis, name in enumerate(PALM_AXES):
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        palm.add_joint(
            name=name, type=slide, axis=np.eye(3)[axis], range=GANTRY_RANGE_M[axis], limited=True
        )
        add_servo(spec, name, PALM_MASS_KG + fingers_kg, PALM_BANDWIDTH_RAD_S, PALM_FORCE_N)
    palm.add_site(name=PALM_SITE, pos=(0.0, 0.0, 0.0))
    forward = (cos(CAMERA_PITCH_RAD), 0.0, -sin(CAMERA_PITCH_RAD))
    palm.add_camera(name=EGO_VIEW, pos=CAMERA_POS, quat=camera_quat(forward), fovy=CAMERA_FOVY_DEG)
    return palm


def add_servo(
    spec: mujoco.MjSpec, joint: str, inertia: float, bandwidth_rad_s: float, limit: float
) -> mujoco.MjsActuator:
    """Add and return a critically damped position servo: force = kp (u - q) - kv qdot, clipped to
    +- ``limit``.
    """
    kp = inertia * bandwidth_rad_s**2
    kv = 2 * inertia * bandwidth_rad_s
    actuator = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.set_to_position(kp, kv=kv)
    actuator.forcelimited = True
    actuator.forcerange = (-limit, limit)
    return actuator


def quat_z_to(direction: np.ndarray) -> np.ndarray:
    """Return (4,) quaternion wxyz that turns z to ``direction`` (3,) the short way."""
    quat = np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, direction)
    return quat
