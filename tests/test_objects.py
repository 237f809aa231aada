"""What must hold of every registered object, with no line per object, and distances from solids."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.stats import qmc

from dynahoi_lerobot.core.numerics import quat_to_matrix
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.hands.robot import RobotHand
from dynahoi_lerobot.objects import OBJECTS, Primitive, TargetObject
from dynahoi_lerobot.objects.base import FRICTION_RANGE, MASS_RANGE_KG
from dynahoi_lerobot.objects.primitives import as_table, extent, from_table
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.scene.model import LARGEST_SLOT_M, SHAPES
from dynahoi_lerobot.scene.scene import compile_scene
from dynahoi_lerobot.scene.signed_distance import signed_distance

NAMES = OBJECTS.names()
IN_DISTRIBUTION = BENCHMARK.splits["train"].objects
DRAWS = 200
POINTS = 20_000


def draws(name: str, count: int = DRAWS) -> list[TargetObject]:
    rng = np.random.default_rng(11)
    return [OBJECTS[name].sample(rng) for _ in range(count)]


@pytest.mark.parametrize("name", NAMES)
def test_is_a_function_of_the_seed_and_in_range_and_the_scene_has_a_slot_for_each_of_its_solids(
    name: str,
):
    targets = draws(name)
    scene = compile_scene()
    assert targets[:3] == draws(name, 3)
    assert len(set(targets[:3])) == 3
    for target in targets:
        assert target.name == name
        assert MASS_RANGE_KG[0] <= target.mass_kg <= MASS_RANGE_KG[1]
        assert FRICTION_RANGE[0] <= target.friction <= FRICTION_RANGE[1]
        assert 0.01 < target.grasp_radius_m < 0.05
        assert (target.roll_radius_m > 0) == OBJECTS[name].rolls
        for primitive in target.primitives:
            assert all(0.0 < size < LARGEST_SLOT_M for size in primitive.size)
        geoms = scene.slots_of(target)
        assert len(set(geoms)) == len(target.primitives)
        assert [scene.model.geom(geom).type for geom in geoms] == [
            SHAPES[p.shape] for p in target.primitives
        ]


def test_too_many_primitives_are_refused_by_name():
    target = draws("egg", 1)[0]
    crowded = replace(target, primitives=target.primitives * 3)
    with pytest.raises(
        ValueError, match=r"object 'egg' needs 3 ellipsoid, but .* 1 box, 8 capsule, .* 1 ellipsoid"
    ):
        compile_scene().slots_of(crowded)


@pytest.mark.parametrize("name", NAMES)
def test_its_size_and_rest_height_are_those_of_its_solids_which_can_be_stored(name: str):
    for target in draws(name, 20):
        low, high = _extent(target)
        assert -low[2] == pytest.approx(target.rest_height_m, abs=1e-9)
        np.testing.assert_allclose(extent(target.primitives), high - low, rtol=1e-9)
        table = as_table(target.primitives)
        assert table.shape == (len(target.primitives), 11)
        np.testing.assert_array_equal(as_table(from_table(table)), table)


@pytest.mark.parametrize("name", NAMES)
def test_the_origin_is_its_center_of_mass(name: str):
    """To 2 % of the extent, four standard errors of as many random points; solids that overlap
    count once.
    """
    for target in draws(name, 3):
        points, (low, high) = _points_inside(target), _extent(target)
        extent = (high - low).max()
        assert (points.std(axis=0) / np.sqrt(len(points))).max() < 0.005 * extent
        np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.02 * extent)


@pytest.mark.parametrize("name", NAMES)
def test_inertia_is_what_mujoco_computes_from_its_solids(name: str):
    """Both count what solids share twice."""
    for target in draws(name, 5):
        inertia = _mujoco_inertia(target)
        np.testing.assert_allclose(np.diag(inertia), target.inertia, rtol=1e-6)
        products = inertia - np.diag(np.diag(inertia))
        assert np.abs(products).max() < 1e-6 * max(target.inertia), (
            "the object's axes are its principal axes"
        )


@pytest.mark.parametrize(
    "hand", [name for name in HANDS.names() if not isinstance(HANDS[name], RobotHand)]
)
def test_larger_objects_are_grasped_with_smaller_rotations(hand: str):
    radii = np.linspace(0.015, 0.045, 61)
    joints = np.abs([HANDS[hand].reference_joints(radius) for radius in radii])
    assert joints.shape == (61, 15)
    assert (np.diff(joints, axis=0) <= 1e-12).all()
    in_use = sorted(
        {target.grasp_radius_m for name in IN_DISTRIBUTION for target in draws(name, 20)}
    )
    total = np.array([np.abs(HANDS[hand].reference_joints(radius)).sum() for radius in in_use])
    assert (np.diff(total) < 0).all()
    assert (joints > 0).all(), "every joint takes part in every grasp"


def _top(primitive: Primitive, direction: np.ndarray) -> float:
    """How far a solid extends along a unit vector (3,) from the object's origin [m], from its
    support function.
    """
    x, y, z = direction @ quat_to_matrix(np.asarray(primitive.quat))
    size = np.asarray(primitive.half_size)
    reach = {
        "sphere": size[0],
        "capsule": size[0] + size[1] * abs(z),
        "cylinder": size[0] * np.hypot(x, y) + size[1] * abs(z),
        "ellipsoid": np.linalg.norm(size * (x, y, z)),
        "box": size @ np.abs((x, y, z)),
    }
    return float(direction @ primitive.pos + reach[primitive.shape])


def _extent(target: TargetObject) -> np.ndarray:
    """(2, 3) lowest and highest coordinates of the object [m]."""
    tops = [
        [max(_top(p, sign * axis) for p in target.primitives) for axis in np.eye(3)]
        for sign in (-1.0, 1.0)
    ]
    return np.array([[-1.0], [1.0]]) * tops


def _mujoco_inertia(target: TargetObject) -> np.ndarray:
    """(3, 3) inertia [kg m^2] about the object's origin, as MuJoCo's compiler finds it."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_freejoint()
    for primitive in target.primitives:
        body.add_geom(
            type=SHAPES[primitive.shape],
            size=primitive.half_size,
            pos=primitive.pos,
            quat=primitive.quat,
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((6, 6))
    mujoco.mj_fullM(model, data, inertia)
    return inertia[3:, 3:] * target.mass_kg / model.body_mass[1]


def _points_inside(target: TargetObject) -> np.ndarray:
    """Points (K, 3) [m] of a sequence of low discrepancy in the box around the object that lie in
    any of its solids.
    """
    low, high = _extent(target)
    points = low + (high - low) * qmc.Halton(3, seed=0).random(POINTS)
    inside = np.zeros(len(points), bool)
    for primitive in target.primitives:
        local = (points - primitive.pos) @ quat_to_matrix(np.asarray(primitive.quat))
        size = np.broadcast_to(primitive.half_size, local.shape)
        inside |= signed_distance(primitive.shape, local, size) < 0
    return points[inside]


SIZES = {
    "sphere": (0.03, 0.0, 0.0),
    "capsule": (0.02, 0.03, 0.0),
    "cylinder": (0.03, 0.02, 0.0),
    "ellipsoid": (0.02, 0.025, 0.035),
    "box": (0.02, 0.03, 0.025),
}
POINT_M = 1e-5
NEAR_M = 0.005


@pytest.mark.parametrize("shape", [name for name in SHAPES if name != "ellipsoid"])
def test_distances_are_exact_outside_and_inside(shape: str):
    points, expected = _measured_by_mujoco(shape)
    assert (expected < 0).sum() > 5, "some points must lie inside"
    np.testing.assert_allclose(_ours(shape, points), expected, atol=1e-9)


def test_an_ellipsoid_is_exact_near_its_surface_and_close_elsewhere():
    points, expected = _measured_by_mujoco("ellipsoid")
    error = np.abs(_ours("ellipsoid", points) - expected)
    assert error[np.abs(expected) < NEAR_M].max() < 1e-4
    assert (error / np.abs(expected))[expected > NEAR_M].max() < 0.1
    assert _ours("ellipsoid", np.zeros((1, 3)))[0] == pytest.approx(-0.02), (
        "the center is one half axis deep"
    )


def _ours(shape: str, points: np.ndarray) -> np.ndarray:
    return signed_distance(shape, points, np.broadcast_to(SIZES[shape], points.shape))


def _measured_by_mujoco(shape: str) -> tuple[np.ndarray, np.ndarray]:
    """(K, 3) points around the shape and their (K,) distances."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=SHAPES[shape], size=SIZES[shape])
    spec.worldbody.add_body(mocap=True).add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(POINT_M, 0, 0)
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    points = np.random.default_rng(0).uniform(-0.06, 0.06, (400, 3))
    distances = np.zeros(len(points))
    for i, point in enumerate(points):
        data.mocap_pos[0] = point
        mujoco.mj_kinematics(model, data)
        distances[i] = mujoco.mj_geomDistance(model, data, 0, 1, 1.0, None) + POINT_M
    return points, distances
