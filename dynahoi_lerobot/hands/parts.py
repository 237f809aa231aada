"""What hands are built from: a palm on three driven slides with a camera, servos, drawn skin, and how fingers close."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import GANTRY_RANGE_M, PALM_AXES
from dynahoi_lerobot.core.numerics import cos, sin
from dynahoi_lerobot.hands.base import (
    EGO_CAMERA,
    PALM_BODY,
    PALM_SITE,
    SKIN_GEOM_PREFIX,
    SKIN_GROUP,
    SLEEVE_GEOM,
    camera_quat,
)

PALM_MASS_KG = 0.8
PALM_FORCE_N = 120.0
PALM_BANDWIDTH_RAD_S = 150.0
FINGER_BANDWIDTH_RAD_S = 120.0

CAMERA_POS = (-0.15, 0.03, 0.21)
CAMERA_PITCH_RAD = 0.45
CAMERA_FOVY_DEG = 84.0
"""The camera looks over the back of the hand, along +x and down, and sees past the thumb into the grasp volume."""


SKIN = (0.87, 0.68, 0.55, 1.0)
PALM_X_M = -0.0475
"""Middle of the palm's thickness, palm frame."""
HEEL_Y_M, WRIST_Y_M, SLEEVE_Y_M = -0.062, -0.112, -0.21
"""Where the palm ends, where the sleeve begins and ends, palm frame."""
METACARPALS = {
    "index": (0.018, 0.0118),
    "middle": (0.007, 0.0118),
    "ring": (-0.004, 0.0115),
    "little": (-0.014, 0.0105),
}
"""Of each finger's bone in the palm: height at the heel and radius [m]; it ends in the knuckle."""
KNUCKLE_X_M = -0.0015
"""How far a knuckle stands out on the back of the hand."""


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
    forward = (cos(CAMERA_PITCH_RAD), 0.0, -sin(CAMERA_PITCH_RAD))
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


def add_skin(palm: mujoco.MjsBody, bases: Mapping[str, tuple[float, float, float]]) -> None:
    """Add the drawn palm, wrist and sleeve to the body ``palm``.

    Args:
        palm: the palm's body.
        bases: (3,) first joint of each finger [m], palm frame.
    """
    for finger, (heel_z, radius) in METACARPALS.items():
        knuckle = np.add(bases[finger], (KNUCKLE_X_M, -0.002, 0.0))
        _add_capsule(palm, finger, (PALM_X_M, HEEL_Y_M, heel_z), knuckle, radius)
    _add_capsule(palm, "thumb_mound", (PALM_X_M + 0.004, HEEL_Y_M, 0.012), bases["thumb"], 0.0135)
    _add_capsule(palm, "thumb_web", bases["thumb"], np.add(bases["index"], (0.0, -0.012, -0.004)), 0.0085)
    _add_capsule(palm, "little_mound", (PALM_X_M + 0.003, HEEL_Y_M, -0.010), (PALM_X_M + 0.003, -0.02, -0.024), 0.0125)
    for name, z in (("wrist_upper", 0.0085), ("wrist_lower", -0.0075)):
        _add_capsule(palm, name, (PALM_X_M, HEEL_Y_M, z), (PALM_X_M, WRIST_Y_M, z), 0.0165)
    palm.add_geom(
        name=SLEEVE_GEOM, type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=(0.031, 0, 0), mass=0.0, contype=0, conaffinity=0,
        fromto=(PALM_X_M, WRIST_Y_M, 0.0005, PALM_X_M, SLEEVE_Y_M, 0.0005), rgba=SKIN, group=SKIN_GROUP,
    )  # fmt: skip


def _add_capsule(palm: mujoco.MjsBody, name: str, start: object, end: object, radius: float) -> None:
    palm.add_geom(
        name=f"{SKIN_GEOM_PREFIX}{name}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(radius, 0, 0), mass=0.0,
        fromto=np.concatenate([np.asarray(start), np.asarray(end)]), contype=0, conaffinity=0, rgba=SKIN,
        group=SKIN_GROUP,
    )  # fmt: skip


def close_around(
    grasp_radius_m: float, closure: np.ndarray, distance: np.ndarray, full: Sequence[Sequence[float]]
) -> np.ndarray:
    """Return (15,) joint angles [rad] at which each fingertip is ``grasp_radius_m`` from the middle of the grasp.

    Larger objects give smaller rotations (Figure 3b of the paper). Fingers that cannot come that close stop at full
    closure.

    Args:
        grasp_radius_m: half of the width that the fingers close around.
        closure: (K,) fractions of full closure, increasing.
        distance: (5, K) distance of each fingertip from the middle at these fractions [m], not increasing.
        full: (5, 3) joint angles of each finger at full closure [rad].
    """
    joints = [
        np.asarray(angles) * np.interp(-grasp_radius_m, -finger, closure)
        for angles, finger in zip(full, distance, strict=True)
    ]
    return np.concatenate(joints)
