"""What ``tiles`` has and MuJoCo's ray caster lacks: shadows where the light is taken, calm
textures, smooth edges.
"""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import warp as wp

from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.renderers.raycast import shapes
from tests.world.playing import wait, world

TYPES = {
    mujoco.mjtGeom.mjGEOM_SPHERE: shapes.shadow_sphere,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: shapes.shadow_ellipsoid,
    mujoco.mjtGeom.mjGEOM_CAPSULE: shapes.shadow_capsule,
    mujoco.mjtGeom.mjGEOM_CYLINDER: shapes.shadow_cylinder,
    mujoco.mjtGeom.mjGEOM_BOX: shapes.shadow_box,
}
SIZE_M = np.array([0.3, 0.2, 0.4])
SHARP_RAD = 1e-7
SOFT_RAD = 0.02
DIRECTIONS = 200
every_shape = pytest.mark.parametrize("geom_type", TYPES, ids=lambda one: one.name)


def _kernel_of(shadow: wp.Function) -> wp.Kernel:
    def shares(
        size: wp.vec3,
        spread: float,
        points: wp.array[wp.vec3],
        directions: wp.array[wp.vec3],
        taken: wp.array[float],
    ):
        i = wp.tid()
        taken[i] = shadow(size, spread, points[i], directions[i])

    return wp.Kernel(
        func=shares, key=f"shares_{shadow.key}", module=wp.get_module(f"tests_{shadow.key}")
    )


def shares(
    geom_type: mujoco.mjtGeom, spread: float, points: np.ndarray, to_light: np.ndarray
) -> np.ndarray:
    """(K,) share of the light that the shape takes from points (K, 3) [m], its frame; ``to_light``
    (K, 3).
    """
    with wp.ScopedDevice("cpu"):
        taken = wp.empty(len(points), dtype=float)
        inputs = [
            wp.vec3(*SIZE_M),
            spread,
            wp.array(points, dtype=wp.vec3),
            wp.array(to_light, dtype=wp.vec3),
            taken,
        ]
        wp.launch(_kernel_of(TYPES[geom_type]), len(points), inputs=inputs)
        return taken.numpy()


def ray_blocked(geom_type: mujoco.mjtGeom) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a function that tells (K,) which rays from points (K, 3) in directions (K, 3) meet the
    shape.
    """
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=geom_type, size=SIZE_M)
    model = spec.compile()
    data, found = mujoco.MjData(model), np.zeros(1, np.int32)
    mujoco.mj_kinematics(model, data)

    def blocked(points: np.ndarray, to_light: np.ndarray) -> np.ndarray:
        rays = zip(points, to_light, strict=True)
        return np.array(
            [mujoco.mj_ray(model, data, p, d, None, True, -1, found) >= 0 for p, d in rays]
        )

    return blocked


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) unit vectors, a few of them along the axes, where the outlines of shapes
    degenerate.
    """
    drawn = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(count - 6, 3))])
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


@every_shape
def test_a_point_light_is_taken_exactly_where_a_ray_is_blocked(geom_type: mujoco.mjtGeom) -> None:
    """Also beside the shape and between it and the light; but for rays that graze it to within
    rounding.
    """
    rng = np.random.default_rng(0)
    to_light = np.repeat(directions(rng, DIRECTIONS), 100, axis=0)
    points = rng.uniform(-1.0, 1.0, to_light.shape)
    taken = shares(geom_type, SHARP_RAD, points, to_light)
    blocked = ray_blocked(geom_type)(points, to_light)
    outside = ~(blocked & ray_blocked(geom_type)(points, -to_light))
    taken = taken[outside]
    blocked = blocked[outside]
    assert 0.02 < blocked.mean() < 0.6
    assert ((taken > 0.5) != blocked).mean() < 2e-4
    assert ((taken > 0.01) & (taken < 0.99)).mean() < 2e-4


@every_shape
def test_half_shadow_lies_evenly_about_the_edge(geom_type: mujoco.mjtGeom) -> None:
    """On the edge that MuJoCo's rays find half of the light is taken; as much outside as is left
    within.
    """
    rng = np.random.default_rng(1)
    to_light = directions(rng, DIRECTIONS)[6:]
    aside = np.cross(to_light, rng.normal(size=to_light.shape))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    blocked = ray_blocked(geom_type)
    below = -1.0 * to_light
    within = np.zeros(len(aside))
    beyond = np.ones(len(aside))
    for _ in range(20):
        middle = (within + beyond) / 2
        hit = blocked(below + middle[:, None] * aside, to_light)
        within = np.where(hit, middle, within)
        beyond = np.where(hit, beyond, middle)
    on_edge = below + within[:, None] * aside
    step = 0.5 * SOFT_RAD * aside
    edge, inner, outer = (
        shares(geom_type, SOFT_RAD, on_edge + k * step, to_light) for k in (0, -1, 1)
    )
    np.testing.assert_allclose(np.median(edge), 0.5, atol=0.01)
    np.testing.assert_allclose(np.median(inner + outer), 1.0, atol=0.02)
    assert np.quantile(np.abs(edge - 0.5), 0.9) < 0.05
    assert np.quantile(np.abs(inner + outer - 1.0), 0.9) < 0.1
    assert np.median(inner - outer) > 0.4


SIZE = 96


def plain(spec: EpisodeSpec) -> EpisodeSpec:
    """Return the episode without patterns, rugs and other furniture."""
    patterns = ("target_pattern", "floor_pattern", "wall_pattern", "box_pattern")
    changes = dict.fromkeys(patterns, "plain") | {"furniture": ()}
    return replace(spec, appearance=replace(spec.appearance, **changes, target_alpha=1.0))


def test_images_are_near_what_many_samples_would_show(specs: list[EpisodeSpec]) -> None:
    """Against images four times as large, averaged down, a third of the error goes."""
    error = {}
    for renderer in ("tiles", "flat"):
        small, large = (
            world(specs[:22:3], image_size=size, renderer=renderer).cameras.render().astype(float)
            for size in (SIZE, 4 * SIZE)
        )
        mean = large.reshape(-1, SIZE, 4, SIZE, 4, 3).mean(axis=(2, 4))
        error[renderer] = float(np.sqrt(((small - mean) ** 2).mean()))
    assert error["tiles"] < 0.67 * error["flat"]


def test_a_target_without_opacity_casts_no_shadow(specs: list[EpisodeSpec]) -> None:
    worlds = []
    for alpha in (1.0, 0.0):
        shown = [
            replace(plain(s), appearance=replace(plain(s).appearance, target_alpha=alpha))
            for s in specs[:22]
        ]
        worlds.append(world(shown, image_size=SIZE))
        wait(worlds[-1])
    solid, clear = (batch.cameras.render().astype(int).sum(axis=-1) for batch in worlds)
    floor = worlds[0].cameras.segmentation() == worlds[0].scene.floor_geom
    floor[:, 1:-1, 1:-1] &= (
        floor[:, 2:, 1:-1] & floor[:, :-2, 1:-1] & floor[:, 1:-1, 2:] & floor[:, 1:-1, :-2]
    )
    brighter = np.where(floor, clear - solid, 0)[
        :, 1:-1, 1:-1
    ]  # off the edges of what stands before it
    assert (brighter >= 0).all()
    assert (brighter > 30).any(
        axis=(1, 2)
    ).sum() >= 8  # 9 of 22 shadows lie where the hand's camera sees the floor
