"""Distance from fingertips to the target's surface: signed distances of the primitives, for all
worlds at once.
"""

import numpy as np


def signed_distance(shape: str, points: np.ndarray, half_size: np.ndarray) -> np.ndarray:
    """Return the signed distance [m] of points to a primitive centered at the origin, negative
    inside.

    Args:
        shape: ``sphere``, ``capsule``, ``cylinder``, ``ellipsoid`` or ``box``.
        points: (..., 3) in the primitive's frame [m].
        half_size: (..., 3) MuJoCo half-sizes [m].

    Returns:
        (...) distances; exact, except for ellipsoids (first-order, exact on the surface).
    """
    return _DISTANCES[shape](points, half_size)


def _sphere(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points, axis=-1) - size[..., 0]


def _capsule(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    beyond = points.copy()
    beyond[..., 2] -= np.clip(points[..., 2], -size[..., 1], size[..., 1])
    return np.linalg.norm(beyond, axis=-1) - size[..., 0]


def _cylinder(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    radial = np.linalg.norm(points[..., :2], axis=-1) - size[..., 0]
    axial = np.abs(points[..., 2]) - size[..., 1]
    return _from_slabs(np.stack([radial, axial], axis=-1))


def _box(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    return _from_slabs(np.abs(points) - size)


def _ellipsoid(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    scaled = np.linalg.norm(points / size, axis=-1)
    gradient = np.linalg.norm(points / size**2, axis=-1)
    deepest = -size.min(axis=-1)
    return np.where(gradient > 1e-9, scaled * (scaled - 1) / np.maximum(gradient, 1e-9), deepest)


def _from_slabs(excess: np.ndarray) -> np.ndarray:
    """Combine how far a point exceeds each slab: Euclidean outside, the nearest face inside."""
    outside = np.linalg.norm(np.maximum(excess, 0.0), axis=-1)
    return outside + np.minimum(excess.max(axis=-1), 0.0)


_DISTANCES = {
    "sphere": _sphere,
    "capsule": _capsule,
    "cylinder": _cylinder,
    "ellipsoid": _ellipsoid,
    "box": _box,
}
