"""Appearance changes images and nothing else; each randomization has random numbers of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.core.numerics import quat_to_matrix
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.randomization import RANDOMIZATIONS, randomize_appearance
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import world

SIZE = 64
LIGHT_DIR = (0.7, 0.2, -1.0)
DARK = (0.1, 0.1, 0.1)


def images(specs: list[EpisodeSpec], renderer: str = "tiles") -> np.ndarray:
    return world(specs, image_size=SIZE, renderer=renderer).cameras.render().astype(int)


@pytest.fixture(scope="module")
def few(specs: list[EpisodeSpec]) -> list[EpisodeSpec]:
    return specs[:22:3]


@pytest.mark.parametrize("name", RANDOMIZATIONS)
def test_a_randomization_changes_what_is_seen_in_every_episode(name: str, few: list[EpisodeSpec]) -> None:
    varied = [randomize_appearance(spec, [name]) for spec in few]
    assert all(new.appearance != old.appearance for new, old in zip(varied, few, strict=True))
    assert (np.abs(images(varied) - images(few)).max(axis=(1, 2, 3)) > 8).mean() > 0.7


@pytest.mark.parametrize("name", RANDOMIZATIONS)
def test_randomizations_do_not_disturb_each_other(name: str, few: list[EpisodeSpec]) -> None:
    """What one of them sets is the same alone and with all others."""
    for spec in few:
        alone, together = (
            randomize_appearance(spec, [name]).appearance,
            randomize_appearance(spec, list(RANDOMIZATIONS)).appearance,
        )
        changed = [name for name, value in vars(alone).items() if value != getattr(spec.appearance, name)]
        assert changed
        assert all(getattr(alone, name) == getattr(together, name) for name in changed)


def test_nothing_but_images_changes() -> None:
    plain = next(record(Recipe(image_size=32), [3]))
    varied = next(record(Recipe(image_size=32, appearance=tuple(RANDOMIZATIONS)), [3]))
    for name in ("state", "action", "target_pose", "target_contacts"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(varied, name))
    assert plain.meta.task == varied.meta.task
    assert np.abs(plain.images["ego"].astype(int) - varied.images["ego"]).mean() > 5


def test_distractors_stand_behind_the_targets_path(few: list[EpisodeSpec]) -> None:
    for spec in few:
        things = randomize_appearance(spec, ["distractors"]).appearance.distractors
        assert 1 <= len(things) <= 4
        assert all(thing.pos_w[0] - max(thing.half_size) > spec.oracle_path[:, 0].max() for thing in things)


def test_translucent_targets_are_blended_with_what_is_behind(few: list[EpisodeSpec]) -> None:
    """Without soft light: a translucent target also casts a paler shadow, and smooth edges blend once more."""

    def seen(alpha: float) -> np.ndarray:
        varied = [replace(spec, appearance=replace(spec.appearance, target_alpha=alpha)) for spec in few]
        return images(varied, "flat")

    solid, behind = seen(1.0), seen(0.0)
    assert np.abs(seen(0.4) - (0.4 * solid + 0.6 * behind)).max() < 3


def test_highlights_only_brighten_and_lie_where_the_light_is_reflected() -> None:
    """On a ball, the brightest point is where its normal halves the angle between light and camera, to 1.5 pixels."""
    balls = sample_specs(Recipe(motions=("constant", "lateral", "horizontal_circle"), objects=("ball",)), range(6))
    batch, added = highlights(balls)
    assert added.min() >= 0
    compared = 0
    for i in range(len(balls)):
        on_target = np.isin(batch.cameras.segmentation()[i], batch.scene.target_geoms)
        wanted = reflection_pixel(batch, i)
        if on_target.sum() > 60 and on_target[tuple(np.round(wanted).astype(int))]:
            brightest = np.argwhere(on_target & (added[i] >= 0.98 * added[i][on_target].max())).mean(axis=0)
            assert np.linalg.norm(brightest - wanted) < 1.5
            compared += 1
    assert compared >= 4


def highlights(specs: list[EpisodeSpec]) -> tuple[WorldBatch, np.ndarray]:
    """A batch of glossy targets under a light from behind the camera, and (N, H, W) what gloss adds [grey levels]."""
    plain = {"light_dir": LIGHT_DIR, "target_pattern": "plain", "target_rgb": DARK}
    dull, glossy = (
        world([replace(s, appearance=replace(s.appearance, gloss=gloss, **plain)) for s in specs], image_size=2 * SIZE)
        for gloss in (0.0, 0.25)
    )
    return glossy, (glossy.cameras.render().astype(int) - dull.cameras.render()).sum(axis=-1)


def reflection_pixel(batch: WorldBatch, i: int) -> np.ndarray:
    """(row, column) of the point of a ball at which light is reflected into the camera."""
    scene, spec = batch.scene, batch.specs[i]
    assert spec is not None
    camera = scene.model.camera(scene.camera)
    camera_pos = batch.state[i, :3] + camera.pos
    to_light = -np.asarray(LIGHT_DIR) / np.linalg.norm(LIGHT_DIR)
    point = centre = batch.target_pose[i, :3]
    for _ in range(20):
        to_camera = (camera_pos - point) / np.linalg.norm(camera_pos - point)
        normal = (to_light + to_camera) / np.linalg.norm(to_light + to_camera)
        point = centre + spec.target.grasp_radius_m * normal
    right, up, back = (point - camera_pos) @ quat_to_matrix(np.asarray(camera.quat))
    focal = SIZE / np.tan(np.radians(camera.fovy[0]) / 2)  # of images 2 * SIZE wide
    return np.array([SIZE - focal * up / -back, SIZE + focal * right / -back]) - 0.5
