"""The bundled hands: left hands of capsules, palm facing +x, fingers pointing +y, thumb up.

Lengths follow an adult hand; the palm hangs on a three-axis gantry. The palm centre lies 3.6 cm in front of the palm's
surface, in the middle of what the fingers enclose. Every joint is a position servo with a force limit.
"""

import functools
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import FINGER_DOF, FINGERS
from dynahoi_lerobot.core.numerics import norm, product
from dynahoi_lerobot.hands.base import HAND_GEOM_PREFIX, HANDS, HIDDEN_GROUP, Hand
from dynahoi_lerobot.hands.parts import (
    FINGER_BANDWIDTH_RAD_S,
    SKIN,
    add_palm,
    add_servo,
    add_skin,
    close_around,
    quat_z_to,
)

LINK_MASS_KG = 0.012
FINGER_TORQUE_NM = 1.2
FINGER_ARMATURE = 2.0e-4
"""Reflected rotor inertia [kg m^2]; it dominates the finger links' own."""
FLEXION_RANGE_RAD = (-0.05, 1.6)
"""The open hand, at zero, touches no limit: an idle limit would be a constraint in every physics step."""


@dataclass(frozen=True)
class Finger:
    """One finger: where it starts, its three links, and how it lies at rest.

    Attributes:
        base: first joint, palm frame [m].
        along: direction of the straight finger, unit vector, palm frame.
        axis: flexion axis, unit vector, palm frame; positive rotation closes.
        lengths: of the three links [m].
        radius: of the links [m].
        closed: (3,) joint angles of the closed hand [rad].
    """

    base: tuple[float, float, float]
    along: tuple[float, float, float]
    axis: tuple[float, float, float]
    lengths: tuple[float, float, float]
    radius: float
    closed: tuple[float, float, float]


def _row_finger(z: float, scale: float) -> Finger:
    lengths = (0.046 * scale, 0.029 * scale, 0.022 * scale)
    return Finger((-0.046, 0.014, z), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), lengths, 0.0085, (1.15, 1.35, 1.0))


HAND = {
    "thumb": Finger(
        (-0.042, -0.022, 0.032), (0.0, -0.5, 0.8660), (0.0, 0.8660, 0.5), (0.044, 0.034, 0.026), 0.0095, (1.0, 1.4, 0.8)
    ),
    "index": _row_finger(0.034, 0.98),
    "middle": _row_finger(0.013, 1.05),
    "ring": _row_finger(-0.008, 1.0),
    "little": _row_finger(-0.028, 0.82),
}
OPPOSED_THUMB = Finger(
    (-0.042, -0.03, 0.004), (0.0, -0.9798, 0.2), (0.0, 0.2, 0.9798), (0.044, 0.034, 0.026), 0.0095, (1.0, 1.4, 0.8)
)
"""Points away from the fingers and a little up, and flexes towards them."""
JOINT_SUFFIXES = ("base", "middle", "tip")


@HANDS.register("capsule")
class CapsuleHand(Hand):
    """Eighteen degrees of freedom: three slides of the palm and three flexion joints in each of five fingers."""

    fingers: ClassVar[dict[str, Finger]] = HAND

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add palm, fingers, servos, sites and the ego camera to ``spec``."""
        palm = add_palm(spec, FINGER_DOF * LINK_MASS_KG)
        palm.add_geom(
            name=f"{HAND_GEOM_PREFIX}palm", type=mujoco.mjtGeom.mjGEOM_BOX, pos=(-0.0475, -0.03, 0.003),
            size=(0.0115, 0.045, 0.041), rgba=SKIN, mass=0.0, group=HIDDEN_GROUP,
        )  # fmt: skip
        for name in FINGERS:
            self._add_finger(spec, palm, name, self.fingers[name])
        add_skin(palm, {name: finger.base for name, finger in self.fingers.items()})

    def reference_joints(self, grasp_radius_m: float) -> np.ndarray:
        """Return (15,) angles [rad] at which each fingertip pad is ``grasp_radius_m`` away from the palm's axis.

        Larger objects give smaller rotations (Figure 3b of the paper). Fingers that cannot come that close stop at
        full closure.
        """
        closure, distance = self._closure_table()
        return close_around(grasp_radius_m, closure, distance, [self.fingers[name].closed for name in FINGERS])

    @classmethod
    @functools.cache
    def _closure_table(cls) -> tuple[np.ndarray, np.ndarray]:
        """Closure fractions (K,) and, per finger, the pad's distance (5, K) [m] from the middle of the grasp volume.

        That is the axis through the palm centre, along z: fingers close around an upright object. The thumb's is the
        distance to the palm centre itself, as it comes from above.
        """
        closure, distance = np.linspace(0.0, 1.0, 101), np.zeros((len(FINGERS), 101))
        for i, name in enumerate(FINGERS):
            pads = [pad_position(cls.fingers[name], share) for share in closure]
            distance[i] = [norm(pad if name == "thumb" else pad[:2]) for pad in pads]
        return closure, np.minimum.accumulate(distance, axis=1)

    def _add_finger(self, spec: mujoco.MjSpec, palm: mujoco.MjsBody, name: str, finger: Finger) -> None:
        parent, pos = palm, np.asarray(finger.base)
        along = np.asarray(finger.along)
        for suffix, length in zip(JOINT_SUFFIXES, finger.lengths, strict=True):
            link = parent.add_body(name=f"{name}_{suffix}", pos=pos, gravcomp=1.0)
            joint = f"{name}_{suffix}"
            link.add_joint(
                name=joint, axis=finger.axis, range=FLEXION_RANGE_RAD, limited=True, armature=FINGER_ARMATURE
            )
            add_servo(spec, joint, FINGER_ARMATURE, FINGER_BANDWIDTH_RAD_S, FINGER_TORQUE_NM)
            link.add_geom(
                name=f"{HAND_GEOM_PREFIX}{joint}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, mass=LINK_MASS_KG, rgba=SKIN,
                fromto=np.concatenate([np.zeros(3), along * length]), size=(finger.radius, 0, 0),
            )  # fmt: skip
            parent, pos = link, along * length
        pad = along * finger.lengths[-1] + finger.radius * np.cross(finger.axis, along)
        parent.add_site(name=f"{name}_tip", pos=pad, quat=quat_z_to(along))


@HANDS.register("opposed")
class OpposedHand(CapsuleHand):
    """The capsule hand with an abducted thumb: fingers and thumb close around the target from opposite sides.

    The thumb of the capsule hand comes from above, so that a target which the four fingers push sideways slips out
    under it. With the thumb abducted, fingers, thumb and palm enclose the target, in grasps that friction must hold.
    """

    fingers: ClassVar[dict[str, Finger]] = {**HAND, "thumb": OPPOSED_THUMB}


def pad_position(finger: Finger, closure: float) -> np.ndarray:
    """Return (3,) the fingertip pad [m], palm frame, at a fraction of full closure."""
    pos, rotation = np.asarray(finger.base, float), np.eye(3)
    along = np.asarray(finger.along)
    for angle, link in zip(finger.closed, finger.lengths, strict=True):
        rotation = product(rotation, _turn(np.asarray(finger.axis), angle * closure))
        pos = pos + product(rotation, along) * link
    return pos + product(rotation, np.cross(finger.axis, along)) * finger.radius


def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    quat, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quat, axis, angle)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)
