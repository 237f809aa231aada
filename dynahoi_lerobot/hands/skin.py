"""What is drawn of the bundled hands' palm: it narrows towards the wrist, has knuckles, thumb mound, web and a sleeve.

None of it collides or has mass: the palm that collides is a box, which is not drawn.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from dynahoi_lerobot.hands.base import SKIN_GEOM_PREFIX, SKIN_GROUP, SLEEVE_GEOM

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
