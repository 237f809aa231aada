"""Furniture is drawn for each episode, stands clear of everything that moves, and hides no target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.sampling.furniture import furnish
from dynahoi_lerobot.scene.model import ARENA_HALF_M, FURNITURE_SLOTS
from tests.world.playing import wait, world


def test_every_seed_has_its_own_furniture(specs: list[EpisodeSpec]) -> None:
    assert all(furnish(spec).appearance == spec.appearance for spec in specs[:22]), "it is a function of the episode"
    rooms = {spec.appearance.furniture for spec in specs[:22]}
    assert len(rooms) >= 20
    assert np.median([len(room) for room in rooms]) >= 5
    assert max(len(room) for room in rooms) <= FURNITURE_SLOTS


def test_furniture_stands_in_the_room_and_clear_of_the_path(specs: list[EpisodeSpec]) -> None:
    for spec in specs[:44]:
        low, high = spec.oracle_path.min(axis=0) - 0.3, spec.oracle_path.max(axis=0) + 0.3
        for solid in spec.appearance.furniture:
            pos, half = np.asarray(solid.pos_w), np.asarray(solid.half_size)
            assert (np.abs(pos[:2]) + half[:2] <= ARENA_HALF_M + 1e-6).all()
            assert (pos - half > high).any() or (pos + half < low).any(), spec.motion.name


def test_furniture_hides_no_target(specs: list[EpisodeSpec]) -> None:
    bare = [replace(spec, appearance=replace(spec.appearance, furniture=())) for spec in specs[:22]]
    views = []
    for some in (specs[:22], bare):
        batch = world(some, image_size=96, views=("side",))
        wait(batch)
        labels = [batch.cameras._renderer(camera).segmentation(np.arange(22)) for camera in ("ego", "side")]
        views.append(np.isin(labels, batch.scene.target_geoms))
    assert views[1].any(axis=(2, 3)).mean() > 0.8
    np.testing.assert_array_equal(views[0], views[1])
