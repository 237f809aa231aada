"""How far each finger closes around an object: inverts the table from closure to fingertip distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


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
