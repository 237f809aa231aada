"""What all hands have in common: a palm on three driven slides, the site in its grasp volume, and the camera."""

from __future__ import annotations

import mujoco
import numpy as np

from dynahoi_lerobot.foundation.conventions import GANTRY_RANGE_M, PALM_AXES
from dynahoi_lerobot.hands.base import EGO_CAMERA, PALM_BODY, PALM_SITE, camera_quat

PALM_MASS_KG = 0.8
PALM_FORCE_N = 120.0
PALM_BANDWIDTH_RAD_S = 150.0
FINGER_BANDWIDTH_RAD_S = 120.0

CAMERA_POS = (-0.15, 0.03, 0.21)
CAMERA_PITCH_RAD = 0.45
CAMERA_FOVY_DEG = 84.0
"""The camera looks over the back of the hand, along +x and down, and sees past the thumb into the grasp volume."""


def add_palm(spec: mujoco.MjSpec, fingers_kg: float) -> mujoco.MjsBody:
    """Add the palm's body, slides, servos, site and camera, without any geom; return the body.

    Args:
        spec: the model under construction.
        fingers_kg: mass of the fingers, which the servos move together with the palm.
    """
    palm = spec.worldbody.add_body(name=PALM_BODY, gravcomp=1.0)
    palm.explicitinertial = True
    palm.mass, palm.inertia, palm.ipos = PALM_MASS_KG, (8e-4,) * 3, (0.0, 0.0, 0.0)
    for axis, name in enumerate(PALM_AXES):
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        palm.add_joint(name=name, type=slide, axis=np.eye(3)[axis], range=GANTRY_RANGE_M[axis], limited=True)
        add_servo(spec, name, PALM_MASS_KG + fingers_kg, PALM_BANDWIDTH_RAD_S, PALM_FORCE_N)
    palm.add_site(name=PALM_SITE, pos=(0.0, 0.0, 0.0))
    forward = (np.cos(CAMERA_PITCH_RAD), 0.0, -np.sin(CAMERA_PITCH_RAD))
    palm.add_camera(name=EGO_CAMERA, pos=CAMERA_POS, quat=camera_quat(forward), fovy=CAMERA_FOVY_DEG)
    return palm


def add_servo(spec: mujoco.MjSpec, joint: str, inertia: float, bandwidth_rad_s: float, limit: float) -> None:
    """Add a critically damped position servo: force = kp (u - q) - kv qdot, clipped to +- ``limit``."""
    kp, kv = inertia * bandwidth_rad_s**2, 2 * inertia * bandwidth_rad_s
    actuator = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.set_to_position(kp, kv=kv)
    actuator.forcelimited, actuator.forcerange = True, (-limit, limit)


def quat_z_to(direction: np.ndarray) -> np.ndarray:
    """Return (4,) quaternion wxyz that turns z to ``direction`` (3,) the short way."""
    quat = np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, direction)
    return quat
