"""Rotations of many worlds at once; products, lengths and functions whose last bit does not depend
on the processor.

BLAS, NumPy (for AVX-512) and the C library (for FMA) have variants of their functions, which round
differently from one processor to the next. What decides an episode is computed by NumPy's plain
loops and by the functions here; functions of angles use long doubles, which have one variant.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

TOLERANCE = 1e-5
"""Greatest difference of a number [its unit] of an episode that another processor plays; on one
machine it is 0."""


def quat_to_matrix(quat: np.ndarray) -> np.ndarray:
    """Return (..., 3, 3) rotation matrices of (..., 4) unit quaternions wxyz."""
    w, x, y, z = np.moveaxis(quat, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), (0, 1), (-2, -1)))


def matrix_to_quat(matrix: np.ndarray) -> np.ndarray:
    """Return (..., 4) unit quaternions wxyz, w >= 0, of (..., 3, 3) rotation matrices.

    Of the four equivalent formulas, the one that divides by the largest component is taken for
    each.
    """
    m = matrix
    xx = m[..., 0, 0]
    yy = m[..., 1, 1]
    zz = m[..., 2, 2]
    a = m[..., 2, 1] - m[..., 1, 2]
    b = m[..., 0, 2] - m[..., 2, 0]
    c = m[..., 1, 0] - m[..., 0, 1]
    d = m[..., 0, 1] + m[..., 1, 0]
    e = m[..., 0, 2] + m[..., 2, 0]
    f = m[..., 1, 2] + m[..., 2, 1]
    scaled = np.stack(
        [
            np.stack([1 + xx + yy + zz, a, b, c], axis=-1),
            np.stack([a, 1 + xx - yy - zz, d, e], axis=-1),
            np.stack([b, d, 1 - xx + yy - zz, f], axis=-1),
            np.stack([c, e, f, 1 - xx - yy + zz], axis=-1),
        ],
        axis=-2,
    )  # (..., 4 formulas, 4)
    best = np.diagonal(scaled, axis1=-2, axis2=-1).argmax(axis=-1)
    quat = np.take_along_axis(scaled, best[..., None, None], axis=-2)[..., 0, :]
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    return np.where(quat[..., :1] < 0, -quat, quat)


def matrix_to_rotvec(matrix: np.ndarray) -> np.ndarray:
    """Return (..., 3) rotation vectors [rad], at most pi long, of (..., 3, 3) rotation matrices."""
    quat = matrix_to_quat(matrix)
    sine = np.linalg.norm(quat[..., 1:], axis=-1, keepdims=True)
    angle = 2 * arctan2(sine, quat[..., :1])
    return quat[..., 1:] * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 2.0)


def product(rows: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return ``rows @ matrix``, (..., k) times (k, m) or (k,), the same to the last bit on every
    x86-64 processor.
    """
    return np.einsum("...k,km->...m" if np.ndim(matrix) == 2 else "...k,k->...", rows, matrix)


def norm(vector: ArrayLike) -> float:
    """Return the length of a vector (k,), which ``np.linalg.norm`` leaves to BLAS unless it is told
    an axis.
    """
    return float(np.linalg.norm(vector, axis=-1))


def segment_distance(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return (K, F - 1) the least distance of points (K, 3) to each straight piece of a path (F,
    3).
    """
    steps = np.diff(path, axis=0)  # (F - 1, 3)
    from_start = points[:, None] - path[:-1]  # (K, F - 1, 3)
    share = np.einsum("kfd,fd->kf", from_start, steps) / np.maximum((steps**2).sum(axis=1), 1e-12)
    return np.linalg.norm(from_start - np.clip(share, 0.0, 1.0)[..., None] * steps, axis=-1)


def runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """Return the (start, end) of each run of True in (T,) bool."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _of_long_doubles(function: np.ufunc) -> Callable[..., Any]:
    """Return ``function`` computed in long doubles and rounded to (...) float64."""

    def rounded(*arguments: ArrayLike) -> Any:
        return function(*arguments, dtype=np.longdouble).astype(np.float64)

    return rounded


sin, cos, tan = (_of_long_doubles(function) for function in (np.sin, np.cos, np.tan))
arcsin, arctan2, cbrt = (
    _of_long_doubles(function) for function in (np.arcsin, np.arctan2, np.cbrt)
)
