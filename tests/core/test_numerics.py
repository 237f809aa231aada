"""Conversions of rotations against MuJoCo's at every size of angle; functions that round alike on all processors."""

from __future__ import annotations

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

from dynahoi_lerobot.core.numerics import (
    arcsin,
    arctan2,
    cbrt,
    cos,
    matrix_to_quat,
    matrix_to_rotvec,
    quat_to_matrix,
    sin,
    tan,
)

ANGLES_RAD = [0.0, 1e-12, 1e-8, 1e-4, 0.5, 2.0, np.pi - 1e-4, np.pi - 1e-8, np.pi]


def rotations(angle_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """(K, 4) quaternions and (K, 3, 3) matrices by MuJoCo, about random axes and the three coordinate axes."""
    axes = np.vstack([np.random.default_rng(2).normal(size=(60, 3)), np.eye(3), -np.eye(3)])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    quats, matrices = np.zeros((len(axes), 4)), np.zeros((len(axes), 9))
    for quat, matrix, axis in zip(quats, matrices, axes, strict=True):
        mujoco.mju_axisAngle2Quat(quat, axis, angle_rad)
        mujoco.mju_quat2Mat(matrix, quat)
    return quats, matrices.reshape(-1, 3, 3)


@pytest.mark.parametrize("angle_rad", ANGLES_RAD)
def test_rotations_are_converted_as_mujoco_does(angle_rad: float):
    quats, matrices = rotations(angle_rad)
    np.testing.assert_allclose(quat_to_matrix(quats), matrices, atol=1e-14)
    ours, vectors = matrix_to_quat(matrices), matrix_to_rotvec(matrices)
    assert (ours[:, 0] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(ours, axis=1), 1.0)
    np.testing.assert_allclose(np.abs((ours * quats).sum(axis=1)), 1.0, atol=1e-12)
    np.testing.assert_allclose(quat_to_matrix(ours), matrices, atol=1e-12)
    # the angle enters a matrix as 1 - cos, whose rounding hides angles within 1e-8 of pi
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), angle_rad, atol=3e-8)
    for vector, matrix in zip(vectors, matrices, strict=True):
        quat, back = np.zeros(4), np.zeros(9)
        angle = np.linalg.norm(vector)
        mujoco.mju_axisAngle2Quat(quat, vector / angle if angle else np.array([1.0, 0.0, 0.0]), angle)
        mujoco.mju_quat2Mat(back, quat)
        np.testing.assert_allclose(back.reshape(3, 3), matrix, atol=1e-7)


HERE = [name for name in __cpu_dispatch__ if __cpu_features__[name]]
PROCESSORS = {
    "no AVX-512": {"NPY_DISABLE_CPU_FEATURES": " ".join(name for name in HERE if name.startswith("AVX512"))},
    "the least of all": {"NPY_DISABLE_CPU_FEATURES": " ".join(HERE), "OPENBLAS_CORETYPE": "Prescott"},
    "no FMA in the C library": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2"},
}
DIGEST = """
import hashlib
import numpy as np
from dynahoi_lerobot.core.numerics import *
a, b = np.random.default_rng(0).uniform(-9, 9, (2, 30_000))
results = [sin(a), cos(a), tan(a), arcsin(a / 9), arctan2(a, b), cbrt(a), product(a.reshape(-1, 30), b.reshape(30, -1))]
print(hashlib.sha256(b"".join(result.tobytes() for result in results)).hexdigest())
"""


def test_functions_of_angles_are_numpys_to_the_last_bits() -> None:
    a, b = np.random.default_rng(0).uniform(-9, 9, (2, 1000))
    for ours, theirs in ((sin, np.sin), (cos, np.cos), (tan, np.tan), (cbrt, np.cbrt)):
        np.testing.assert_array_max_ulp(ours(a), theirs(a), 4)
        assert ours(0.5).dtype == np.float64
    np.testing.assert_array_max_ulp(arcsin(a / 9), np.arcsin(a / 9), 4)
    np.testing.assert_array_max_ulp(arctan2(a, b), np.arctan2(a, b), 4)


def test_every_processor_gives_the_same_bytes() -> None:
    def digest(changes: dict[str, str]) -> str:
        words, environment = [sys.executable, "-c", DIGEST], os.environ | changes
        return subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout

    assert {digest(changes) for changes in PROCESSORS.values()} == {digest({})}
