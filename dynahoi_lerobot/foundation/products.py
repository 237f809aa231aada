"""Products by NumPy's own loops, because BLAS rounds differently from one processor to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def product(rows: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return ``rows @ matrix``, (..., k) times (k, m) or (k,), the same to the last bit on every x86-64 processor."""
    return np.einsum("...k,km->...m" if np.ndim(matrix) == 2 else "...k,k->...", rows, matrix)


def norm(vector: ArrayLike) -> float:
    """Return the length of a vector (k,), which ``np.linalg.norm`` leaves to BLAS unless it is told an axis."""
    return float(np.linalg.norm(vector, axis=-1))
