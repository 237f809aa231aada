"""Directions and rotations as plain tuples, the form in which a motion keeps its parameters."""

from __future__ import annotations

import numpy as np

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""wxyz."""


def as_vector(values: np.ndarray) -> Vector:
    """Return a (3,) array as three plain floats."""
    x, y, z = (float(v) for v in values)
    return (x, y, z)


def heading(yaw: float, pitch: float = 0.0) -> Vector:
    """Return the unit vector at ``yaw`` from +x towards +y and ``pitch`` above the horizontal [rad], world."""
    flat = np.cos(pitch)
    return (float(np.cos(yaw) * flat), float(np.sin(yaw) * flat), float(np.sin(pitch)))


def yaw_quat(yaw: float) -> Quaternion:
    """Return the rotation by ``yaw`` [rad] about z, wxyz."""
    return (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2)))


def yaw_pitch_quat(yaw: float, pitch: float) -> Quaternion:
    """Return the rotation that turns +x to ``yaw`` and to ``pitch`` below the horizontal [rad], wxyz."""
    cy, sy, cp, sp = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(pitch / 2), np.sin(pitch / 2)
    return (float(cy * cp), float(-sy * sp), float(cy * sp), float(sy * cp))
