"""Conversions of rotations against MuJoCo's at every size of angle; functions of angles against
NumPy's.
"""

import mujoco
import numpy as np
import pytest

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
    """(K, 4) quaternions and (K, 3, 3) matrices by MuJoCo, about random axes and the three
    coordinate axes.
    """
    axes = np.vstack([np.random.default_rng(2).normal(size=(60, 3)), np.eye(3), -np.eye(3)])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    quats = np.zeros((len(axes), 4))
    matrices = np.zeros((len(axes), 9))
    for quat, matrix, axis in zip(quats, matrices, axes, strict=True):
        mujoco.mju_axisAngle2Quat(quat, axis, angle_rad)
        mujoco.mju_quat2Mat(matrix, quat)
    return quats, matrices.reshape(-1, 3, 3)


@pytest.mark.parametrize("angle_rad", ANGLES_RAD)
def test_rotations_are_converted_as_mujoco_does(angle_rad: float):
    quats, matrices = rotations(angle_rad)
    np.testing.assert_allclose(quat_to_matrix(quats), matrices, atol=1e-14)
    ours = matrix_to_quat(matrices)
    vectors = matrix_to_rotvec(matrices)
    assert (ours[:, 0] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(ours, axis=1), 1.0)
    np.testing.assert_allclose(np.abs((ours * quats).sum(axis=1)), 1.0, atol=1e-12)
    np.testing.assert_allclose(quat_to_matrix(ours), matrices, atol=1e-12)
    # the angle enters a matrix as 1 - cos, whose rounding hides angles within 1e-8 of pi
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), angle_rad, atol=3e-8)
    for vector, matrix in zip(vectors, matrices, strict=True):
        quat = np.zeros(4)
        back = np.zeros(9)
        angle = np.linalg.norm(vector)
        mujoco.mju_axisAngle2Quat(
            quat, vector / angle if angle else np.array([1.0, 0.0, 0.0]), angle
        )
        mujoco.mju_quat2Mat(back, quat)
        np.testing.assert_allclose(back.reshape(3, 3), matrix, atol=1e-7)


def test_functions_of_angles_are_numpys_to_the_last_bits() -> None:
    a, b = np.random.default_rng(0).uniform(-9, 9, (2, 1000))
    for ours, theirs in ((sin, np.sin), (cos, np.cos), (tan, np.tan), (cbrt, np.cbrt)):
        np.testing.assert_array_max_ulp(ours(a), theirs(a), 4)
        assert ours(0.5).dtype == np.float64
    np.testing.assert_array_max_ulp(arcsin(a / 9), np.arcsin(a / 9), 4)
    np.testing.assert_array_max_ulp(arctan2(a, b), np.arctan2(a, b), 4)
