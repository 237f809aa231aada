"""The bundled hands: left hands of capsules, palm facing +x, fingers pointing +y, thumb up.

Lengths follow an adult hand. The palm center lies 3.6 cm in front of the palm's surface, in the
middle of what the fingers enclose. Every joint is a position servo with a force limit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import FINGER_DOF, FINGERS
from dynahoi_lerobot.core.numerics import product
from dynahoi_lerobot.hands.base import (
    FINGER_BANDWIDTH_RAD_S,
    HAND_GEOM_PREFIX,
    HANDS,
    HIDDEN_GROUP,
    IDLE_RANGE_RAD,
    SKIN_GEOM_PREFIX,
    SKIN_GROUP,
    SLEEVE_GEOM,
    Hand,
    add_palm,
    add_servo,
    quat_z_to,
)

LINK_MASS_KG = 0.012
FINGER_TORQUE_NM = 1.2
FINGER_ARMATURE = 2.0e-4
"""Reflected rotor inertia [kg m^2]; it dominates the finger links' own."""
LARGEST_FLEXION_RAD = 1.6


@dataclass(frozen=True)
class Finger:
    """One finger: where it starts, its three links, and how it lies at rest.

    Attributes:
        base: first joint, palm frame [m].
        along: direction of the straight finger, unit vector, palm frame.
        axis: flexion axis, unit vector, palm frame; positive rotation closes.
        lengths: of the three links [m].
        radius: of the links [m].
    """

    base: tuple[float, float, float]
    along: tuple[float, float, float]
    axis: tuple[float, float, float]
    lengths: tuple[float, float, float]
    radius: float


def _row_finger(z: float, scale: float) -> Finger:
    lengths = (0.046 * scale, 0.029 * scale, 0.022 * scale)
    return Finger((-0.046, 0.014, z), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), lengths, 0.0085)


HAND = {
    "thumb": Finger(
        (-0.042, -0.022, 0.032),
        (0.0, -0.5, 0.8660),
        (0.0, 0.8660, 0.5),
        (0.044, 0.034, 0.026),
        0.0095,
    ),
    "index": _row_finger(0.034, 0.98),
    "middle": _row_finger(0.013, 1.05),
    "ring": _row_finger(-0.008, 1.0),
    "little": _row_finger(-0.028, 0.82),
}
OPPOSED_THUMB = Finger(
    (-0.042, -0.03, 0.004), (0.0, -0.9798, 0.2), (0.0, 0.2, 0.9798), (0.044, 0.034, 0.026), 0.0095
)
"""Points away from the fingers and a little up, and flexes towards them: a target that they push
sideways slips out under a thumb that comes from above; this one encloses it with them, in grasps
that friction must hold."""
FULL_CLOSURE_RAD = {
    finger: (1.0, 1.4, 0.8) if finger == "thumb" else (1.15, 1.35, 1.0) for finger in FINGERS
}

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


@dataclass(frozen=True)
class CapsuleHand(Hand):
    """Eighteen degrees of freedom: three slides of the palm and three flexion joints in each of
    five ``fingers``.
    """

    summary: str
    fingers: Mapping[str, Finger]
    full_closure_rad: Mapping[str, tuple[float, float, float]] = field(
        default_factory=lambda: FULL_CLOSURE_RAD
    )

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add palm, fingers, servos, sites and the ego camera to ``spec``."""
        palm = add_palm(spec, FINGER_DOF * LINK_MASS_KG)
        palm.add_geom(
            name=f"{HAND_GEOM_PREFIX}palm",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(-0.0475, -0.03, 0.003),
            size=(0.0115, 0.045, 0.041),
            rgba=SKIN,
            mass=0.0,
            group=HIDDEN_GROUP,
        )
        for name in FINGERS:
            self._add_finger(spec, palm, name, self.fingers[name])
        _add_skin(palm, {name: finger.base for name, finger in self.fingers.items()})

    def fingertips(self, closure: np.ndarray) -> np.ndarray:
        """Return (K, 5, 3) positions of the fingertips [m], palm frame, at fractions (K,) of full
        closure.
        """
        # in closed form: MuJoCo normalizes the axes above, which turns the benchmark's reference
        # grasps by 3e-5 rad
        full = {name: np.array(self.full_closure_rad[name]) for name in FINGERS}
        return np.array(
            [
                [_pad_position(self.fingers[name], k * full[name]) for name in FINGERS]
                for k in closure
            ]
        )

    def _add_finger(
        self, spec: mujoco.MjSpec, palm: mujoco.MjsBody, name: str, finger: Finger
    ) -> None:
        parent = palm
        pos = np.asarray(finger.base)
        along = np.asarray(finger.along)
        for suffix, length in zip(("base", "middle", "tip"), finger.lengths, strict=True):
            link = parent.add_body(name=f"{name}_{suffix}", pos=pos, gravcomp=1.0)
            joint = f"{name}_{suffix}"
            span = (IDLE_RANGE_RAD, LARGEST_FLEXION_RAD)
            link.add_joint(
                name=joint, axis=finger.axis, range=span, limited=True, armature=FINGER_ARMATURE
            )
            add_servo(spec, joint, FINGER_ARMATURE, FINGER_BANDWIDTH_RAD_S, FINGER_TORQUE_NM)
            link.add_geom(
                name=f"{HAND_GEOM_PREFIX}{joint}",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                mass=LINK_MASS_KG,
                rgba=SKIN,
                fromto=np.concatenate([np.zeros(3), along * length]),
                size=(finger.radius, 0, 0),
            )
            parent = link
            pos = along * length
        pad = along * finger.lengths[-1] + finger.radius * np.cross(finger.axis, along)
        parent.add_site(name=f"{name}_tip", pos=pad, quat=quat_z_to(along))


HANDS.register("capsule")(CapsuleHand("A hand of capsules, whose thumb comes from above.", HAND))
HANDS.register("opposed")(
    CapsuleHand("The same with the thumb opposed to the fingers.", {**HAND, "thumb": OPPOSED_THUMB})
)


def _pad_position(finger: Finger, joints: np.ndarray) -> np.ndarray:
    """(3,) the fingertip pad [m], palm frame, at joint angles (3,) [rad]."""
    pos = np.asarray(finger.base, float)
    rotation = np.eye(3)
    along = np.asarray(finger.along)
    quat = np.zeros(4)
    turn = np.zeros(9)
    for angle, link in zip(joints, finger.lengths, strict=True):
        mujoco.mju_axisAngle2Quat(quat, np.asarray(finger.axis), angle)
        mujoco.mju_quat2Mat(turn, quat)
        rotation = product(rotation, turn.reshape(3, 3))
        pos = pos + product(rotation, along) * link
    return pos + product(rotation, np.cross(finger.axis, along)) * finger.radius


def _add_skin(palm: mujoco.MjsBody, bases: Mapping[str, tuple[float, float, float]]) -> None:
    """Add the drawn palm, wrist and sleeve to ``palm``, whose fingers have their first joints at
    ``bases``.
    """
    for finger, (heel_z, radius) in METACARPALS.items():
        knuckle = np.add(bases[finger], (KNUCKLE_X_M, -0.002, 0.0))
        _add_capsule(palm, finger, (PALM_X_M, HEEL_Y_M, heel_z), knuckle, radius)
    _add_capsule(palm, "thumb_mound", (PALM_X_M + 0.004, HEEL_Y_M, 0.012), bases["thumb"], 0.0135)
    _add_capsule(
        palm, "thumb_web", bases["thumb"], np.add(bases["index"], (0.0, -0.012, -0.004)), 0.0085
    )
    _add_capsule(
        palm,
        "little_mound",
        (PALM_X_M + 0.003, HEEL_Y_M, -0.010),
        (PALM_X_M + 0.003, -0.02, -0.024),
        0.0125,
    )
    for name, z in (("wrist_upper", 0.0085), ("wrist_lower", -0.0075)):
        _add_capsule(palm, name, (PALM_X_M, HEEL_Y_M, z), (PALM_X_M, WRIST_Y_M, z), 0.0165)
    palm.add_geom(
        name=SLEEVE_GEOM,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(0.031, 0, 0),
        mass=0.0,
        contype=0,
        conaffinity=0,
        fromto=(PALM_X_M, WRIST_Y_M, 0.0005, PALM_X_M, SLEEVE_Y_M, 0.0005),
        rgba=SKIN,
        group=SKIN_GROUP,
    )


def _add_capsule(
    palm: mujoco.MjsBody, name: str, start: object, end: object, radius: float
) -> None:
    palm.add_geom(
        name=f"{SKIN_GEOM_PREFIX}{name}",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=(radius, 0, 0),
        mass=0.0,
        fromto=np.concatenate([np.asarray(start), np.asarray(end)]),
        contype=0,
        conaffinity=0,
        rgba=SKIN,
        group=SKIN_GROUP,
    )
