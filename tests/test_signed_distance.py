"""Signed distances against MuJoCo's own, with a ball of 10 micrometres as the point."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from dynahoi_lerobot.scene.model import SHAPES
from dynahoi_lerobot.scene.signed_distance import signed_distance

SIZES = {
    "sphere": (0.03, 0.0, 0.0),
    "capsule": (0.02, 0.03, 0.0),
    "cylinder": (0.03, 0.02, 0.0),
    "ellipsoid": (0.02, 0.025, 0.035),
    "box": (0.02, 0.03, 0.025),
}
POINT_M = 1e-5
NEAR_M = 0.005


def test_every_shape_of_the_scene_is_measured():
    assert set(SHAPES) == set(SIZES)


@pytest.mark.parametrize("shape", [name for name in SIZES if name != "ellipsoid"])
def test_distances_are_exact_outside_and_inside(shape: str):
    points, expected = _measured_by_mujoco(shape)
    assert (expected < 0).sum() > 5, "some points must lie inside"
    np.testing.assert_allclose(_ours(shape, points), expected, atol=1e-9)


def test_an_ellipsoid_is_exact_near_its_surface_and_close_elsewhere():
    points, expected = _measured_by_mujoco("ellipsoid")
    error = np.abs(_ours("ellipsoid", points) - expected)
    assert error[np.abs(expected) < NEAR_M].max() < 1e-4
    assert (error / np.abs(expected))[expected > NEAR_M].max() < 0.1
    assert _ours("ellipsoid", np.zeros((1, 3)))[0] == pytest.approx(-0.02), "the centre is one half axis deep"


def _ours(shape: str, points: np.ndarray) -> np.ndarray:
    return signed_distance(shape, points, np.broadcast_to(SIZES[shape], points.shape))


def _measured_by_mujoco(shape: str) -> tuple[np.ndarray, np.ndarray]:
    """(K, 3) points around the shape and their (K,) distances."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=SHAPES[shape], size=SIZES[shape])
    spec.worldbody.add_body(mocap=True).add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(POINT_M, 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    points = np.random.default_rng(0).uniform(-0.06, 0.06, (400, 3))
    distances = np.zeros(len(points))
    for i, point in enumerate(points):
        data.mocap_pos[0] = point
        mujoco.mj_kinematics(model, data)
        distances[i] = mujoco.mj_geomDistance(model, data, 0, 1, 1.0, None) + POINT_M
    return points, distances
