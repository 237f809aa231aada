"""What ``tiles`` has and MuJoCo's ray caster lacks: shadows where the light is taken, calm textures, smooth edges."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.hands.base import SHOWN_GROUP, SKIN_GROUP
from dynahoi_lerobot.renderers.raycast.textures import level_sides, shrink
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import wait, world

SIZE = 96
IN_THE_OPEN_M = 4.5
"""Floor this far from the room's middle is not darkened by the corners."""
LEAST_AGREEMENT = 0.97
"""Share of floor pixels that are dark exactly if a ray to the light is blocked. The rest lie in half-shadow, whose
middle is where the ray begins to be blocked only for straight edges."""

LEAST_FOUND = 0.6
"""Share of the blocked pixels that are darker than others; fingers far above the floor cast half-shadow only."""
HALF_SHADOW_PX = 2
"""The darkest pixels lie this near to blocked ones: 2.6 cm of half-shadow below a hand 1.3 m high are two pixels."""


def plain(spec: EpisodeSpec) -> EpisodeSpec:
    """Return the episode without patterns, rugs and other furniture."""
    patterns = ("target_pattern", "floor_pattern", "wall_pattern", "box_pattern")
    changes = dict.fromkeys(patterns, "plain") | {"furniture": ()}
    return replace(spec, appearance=replace(spec.appearance, **changes))


@pytest.fixture(scope="module")
def plain_worlds(specs: list[EpisodeSpec]) -> WorldBatch:
    batch = world([plain(spec) for spec in specs[:22]], image_size=SIZE, views=("side",))
    wait(batch)
    return batch


def floor_points(batch: WorldBatch, i: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) which pixels of the side view show open floor, off edges; (H, W, 3) what each shows [m], world."""
    renderer = batch.cameras._renderer("side")
    labels, depth = renderer.segmentation(np.array([i]))[0], renderer.depth(np.array([i]))[0]
    camera = batch.scene.model.camera("side")
    focal = SIZE / 2 / np.tan(np.radians(camera.fovy[0]) / 2)
    slopes = (np.arange(SIZE) + 0.5 - SIZE / 2) / focal
    x, y = np.meshgrid(slopes, -slopes)
    rays = np.stack([x, y, -np.ones_like(x)], axis=-1) @ batch._batch.bind("cam_xmat")[i, camera.id].reshape(3, 3).T
    points = batch._batch.bind("cam_xpos")[i, camera.id] + depth[..., None] * rays
    floor = np.pad(labels == batch.scene.floor_geom, 1)
    inner = floor[1:-1, 1:-1] & floor[2:, 1:-1] & floor[:-2, 1:-1] & floor[1:-1, 2:] & floor[1:-1, :-2]
    return inner & (np.abs(points[..., :2]).max(axis=-1) < IN_THE_OPEN_M), points


def blocked(batch: WorldBatch, i: int, points: np.ndarray) -> np.ndarray:
    """(K,) whether MuJoCo's ray from points (K, 3) to the light meets anything that is drawn."""
    model, data = batch._batch.get_model(i), batch._batch.get_data(i)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    groups = np.isin(np.arange(mujoco.mjNGROUP), (SHOWN_GROUP, SKIN_GROUP)).astype(np.uint8)
    rooms = {batch.scene.floor_geom, *batch.scene.wall_geoms}
    model.geom_rgba[list(rooms), 3], model.geom_matid[list(rooms)] = 0.0, -1  # rays pass through what is invisible
    found = np.zeros(1, np.int32)
    to_light = -data.light_xdir[0]
    return np.array([mujoco.mj_ray(model, data, one, to_light, groups, True, -1, found) >= 0 for one in points])


def test_floor_is_dark_where_the_way_to_the_light_is_blocked(plain_worlds: WorldBatch) -> None:
    images, agreement, found = plain_worlds.cameras.render(view="side").astype(int).sum(axis=-1), [], []
    for i in range(0, plain_worlds.size, 2):
        on_floor, points = floor_points(plain_worlds, i)
        if on_floor.sum() < 500:
            continue
        bright = np.quantile(images[i][on_floor], 0.9)
        dark = blocked(plain_worlds, i, points[on_floor])
        if dark.sum() < 10:
            continue
        lit, shadow = bright, images[i][on_floor].min()
        darkness = (lit - images[i][on_floor]) / (lit - shadow)
        agreement.append(((darkness > 0.5) == dark).mean())
        near_blocked = np.zeros_like(on_floor)
        near_blocked[on_floor] = dark
        for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)) * HALF_SHADOW_PX:
            near_blocked |= np.roll(near_blocked, shift, axis)
        darkest = darkness > 0.5
        rightly = darkest & near_blocked[on_floor]
        found.append([(dark & (darkness > 0.2)).sum(), dark.sum(), rightly.sum(), darkest.sum()])
    noticed, blocked_pixels, rightly_dark, dark_pixels = np.sum(found, axis=0)
    assert len(found) >= 5
    assert min(agreement) > LEAST_AGREEMENT
    assert noticed > LEAST_FOUND * blocked_pixels
    assert rightly_dark > 0.95 * dark_pixels


def test_a_target_without_opacity_casts_no_shadow(plain_worlds: WorldBatch, specs: list[EpisodeSpec]) -> None:
    clear = [replace(plain(s), appearance=replace(plain(s).appearance, target_alpha=0.0)) for s in specs[:22]]
    batch = world(clear, image_size=SIZE, views=("side",))
    wait(batch)
    brighter = batch.cameras.render(view="side").astype(int).sum(axis=-1) - plain_worlds.cameras.render(
        view="side"
    ).astype(int).sum(axis=-1)
    floors = np.stack([floor_points(plain_worlds, i)[0] for i in range(plain_worlds.size)])
    assert (brighter[floors] >= 0).all()
    assert sum((brighter[i][floors[i]] > 30).any() for i in range(plain_worlds.size)) >= 8


def test_pictures_are_near_what_many_samples_would_show(specs: list[EpisodeSpec]) -> None:
    """Against pictures four times as large, averaged down, a third of the error goes."""
    error = {}
    for renderer in ("tiles", "flat"):
        small, large = (
            world(specs[:22], image_size=size, renderer=renderer).cameras.render().astype(float)
            for size in (SIZE, 4 * SIZE)
        )
        mean = large.reshape(22, SIZE, 4, SIZE, 4, 3).mean(axis=(2, 4))
        error[renderer] = float(np.sqrt(((small - mean) ** 2).mean()))
    assert error["tiles"] < 0.67 * error["flat"]


def test_less_sharp_textures_keep_their_brightness() -> None:
    texture = np.random.default_rng(0).random((3, 64, 64)).astype(np.float32)
    assert level_sides(64) == [64, 45, 32, 23, 16, 11, 8, 6, 4]
    np.testing.assert_array_equal(shrink(texture, 64), np.round(texture.astype(float) * 4096) / 4096)
    for side in level_sides(64):
        np.testing.assert_allclose(shrink(texture, side).mean(axis=(1, 2)), texture.mean(axis=(1, 2)), atol=1e-3)
    np.testing.assert_allclose(shrink(texture, 32)[0, 0, 0], texture[0, :2, :2].mean(), atol=1e-3)
