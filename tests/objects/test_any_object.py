"""What must hold of every registered object, with no line per object."""

from __future__ import annotations

import re
from collections import Counter
from itertools import chain

import numpy as np
import pytest

from dynahoi_lerobot.foundation.rotations import quat_to_matrix
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.objects import OBJECTS, TargetObject
from dynahoi_lerobot.objects.base import FRICTION_RANGE, MASS_RANGE_KG
from dynahoi_lerobot.scene.scene import LARGEST_SLOT_M, compile_scene
from dynahoi_lerobot.scene.signed_distance import signed_distance

NAMES = OBJECTS.names()
BENCHMARK = [name for name, kind in OBJECTS.items() if not kind.held_out]
DRAWS = 200


def draws(name: str, count: int = DRAWS) -> list[TargetObject]:
    rng = np.random.default_rng(11)
    return [OBJECTS[name].sample(name, rng) for _ in range(count)]


def test_the_benchmark_has_11_objects():
    assert BENCHMARK == ["ball", "block", "bottle", "capsule", "cone", "cube", "cup", "cylinder", "disc", "egg", "ring"]


@pytest.mark.parametrize("name", NAMES)
def test_is_a_function_of_the_seed(name: str):
    assert draws(name, 3) == draws(name, 3)
    assert len(set(draws(name, 3))) == 3


@pytest.mark.parametrize("name", NAMES)
def test_mass_friction_and_sizes_are_in_range(name: str):
    for target in draws(name):
        assert target.name == name
        assert MASS_RANGE_KG[0] <= target.mass_kg <= MASS_RANGE_KG[1]
        assert FRICTION_RANGE[0] <= target.friction <= FRICTION_RANGE[1]
        assert 0.01 < target.grasp_radius_m < 0.05
        assert (target.roll_radius_m > 0) == OBJECTS[name].rolls
        for primitive in target.primitives:
            assert all(0.0 < size < LARGEST_SLOT_M for size in primitive.size)


@pytest.mark.parametrize("name", NAMES)
def test_the_lengths_its_docstring_states_are_the_lengths_drawn(name: str):
    """Every 'a to b' of the docstring is the range of some length: a size, a diameter, a distance or a ratio."""
    text = OBJECTS[name].__doc__ or ""
    stated = [(float(a), float(b)) for a, b in re.findall(r"([\d.]+) to ([\d.]+)", text)]
    assert stated
    lengths = _lengths(draws(name))
    low, high = lengths.min(axis=0), lengths.max(axis=0)
    for first, last in stated:
        slack = 0.05 * (last - first)
        inside = (low >= first - 1e-9) & (high <= last + 1e-9)
        spans = inside & (low < first + slack) & (high > last - slack)
        assert spans.any(), f"nothing is drawn from {first} to {last}"


@pytest.mark.parametrize("name", NAMES)
def test_the_scene_has_slots_for_it(name: str):
    slots = {shape: len(ids) for shape, ids in compile_scene().slots.items()}
    for target in draws(name, 50):
        needed = Counter(primitive.shape for primitive in target.primitives)
        assert needed <= Counter(slots)


@pytest.mark.parametrize("name", NAMES)
def test_stands_at_its_rest_height_around_its_centre_of_mass(name: str):
    """The centre of mass is the origin to 2 % of the extent, and the lowest point lies ``rest_height_m`` below it."""
    for target in draws(name, 3):
        points = _points_inside(target, 100_000)
        extent = np.ptp(points, axis=0).max()
        np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.02 * extent)
        assert -points[:, 2].min() == pytest.approx(target.rest_height_m, abs=0.001)


@pytest.mark.parametrize("name", NAMES)
def test_inertia_is_that_of_its_solids(name: str):
    """Against Monte-Carlo integration: 2 % solid by solid, 16 % where solids that overlap are counted once."""
    for target in draws(name, 2):
        parts = [_points_of(target, i, 40_000) for i in range(len(target.primitives))]
        volumes = np.array([volume for _, volume in parts])
        squares = sum(v * (p**2).mean(axis=0) for p, v in parts) / volumes.sum()
        np.testing.assert_allclose(target.inertia, target.mass_kg * (squares.sum() - squares), rtol=0.02)
        squares = (_points_inside(target, 100_000) ** 2).mean(axis=0)
        np.testing.assert_allclose(target.inertia, target.mass_kg * (squares.sum() - squares), rtol=0.16)


@pytest.mark.parametrize("hand", HANDS.names())
def test_larger_objects_are_grasped_with_smaller_rotations(hand: str):
    radii = np.linspace(0.015, 0.045, 61)
    joints = np.array([HANDS[hand]().reference_joints(radius) for radius in radii])
    assert joints.shape == (61, 15)
    assert (np.diff(joints, axis=0) <= 1e-12).all()
    in_use = sorted({target.grasp_radius_m for name in BENCHMARK for target in draws(name, 20)})
    total = np.array([HANDS[hand]().reference_joints(radius).sum() for radius in in_use])
    assert (np.diff(total) < 0).all()
    assert (joints > 0).all(), "every joint takes part in every grasp"


def _lengths(targets: list[TargetObject]) -> np.ndarray:
    """(K, L) candidate lengths [cm] and ratios of one kind."""
    rows = []
    for target in targets:
        sizes = [size for primitive in target.primitives for size in primitive.size]
        away = [float(np.linalg.norm(primitive.pos)) for primitive in target.primitives]
        ratios = [a / b for p in target.primitives for a in p.size for b in p.size]
        rows.append([*chain.from_iterable((100 * v, 200 * v) for v in (*sizes, *away)), *ratios])
    return np.array(rows)


def _points_inside(target: TargetObject, count: int) -> np.ndarray:
    """Points of the object's frame that lie in any of its solids, uniformly."""
    corners = np.concatenate([_points_of(target, i, 2000)[0] for i in range(len(target.primitives))])
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.1 * (high - low)  # a few thousand points do not reach the poles
    points = np.random.default_rng(3).uniform(low - margin, high + margin, (count, 3))
    return points[np.any([_inside(target, i, points) for i in range(len(target.primitives))], axis=0)]


def _points_of(target: TargetObject, i: int, count: int) -> tuple[np.ndarray, float]:
    """Points of the object's frame that lie in one solid, and its volume [m^3]."""
    primitive = target.primitives[i]
    a, b, _ = primitive.half_size
    box = {"sphere": (a, a, a), "capsule": (a, a, a + b), "cylinder": (a, a, b)}.get(primitive.shape)
    box = np.asarray(box or primitive.half_size)
    local = np.random.default_rng(i).uniform(-box, box, (count, 3))
    points = np.asarray(primitive.pos) + local @ quat_to_matrix(np.asarray(primitive.quat)).T
    inside = _inside(target, i, points)
    return points[inside], 8 * box.prod() * inside.mean()


def _inside(target: TargetObject, i: int, points: np.ndarray) -> np.ndarray:
    primitive = target.primitives[i]
    local = (points - primitive.pos) @ quat_to_matrix(np.asarray(primitive.quat))
    return signed_distance(primitive.shape, local, np.broadcast_to(primitive.half_size, local.shape)) < 0
