"""Appearance and furniture change images and nothing else, and hide no target; each draw has
numbers of its own.
"""

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.randomization import RANDOMIZATIONS, randomize_appearance
from dynahoi_lerobot.scene.furniture import furnish
from dynahoi_lerobot.scene.model import ARENA_HALF_M, FURNITURE_SLOTS
from tests.world.playing import wait, world

SIZE = 64


def images(specs: list[EpisodeSpec], renderer: str = "tiles") -> np.ndarray:
    return world(specs, image_size=SIZE, renderer=renderer).cameras.render().astype(int)


@pytest.fixture(scope="module")
def few(specs: list[EpisodeSpec]) -> list[EpisodeSpec]:
    return specs[:22:3]


@pytest.fixture(scope="module")
def plain(few: list[EpisodeSpec]) -> np.ndarray:
    return images(few)


@pytest.mark.parametrize("name", RANDOMIZATIONS)
def test_a_randomization_changes_what_is_seen_in_every_episode(
    name: str, few: list[EpisodeSpec], plain
) -> None:
    """What it sets is the same alone and with all others."""
    varied = [randomize_appearance(spec, [name]) for spec in few]
    assert all(new.appearance != old.appearance for new, old in zip(varied, few, strict=True))
    assert (np.abs(images(varied) - plain).max(axis=(1, 2, 3)) > 8).mean() > 0.7
    for spec in few:
        alone, together = (
            randomize_appearance(spec, names).appearance for names in ([name], list(RANDOMIZATIONS))
        )
        changed = [
            name for name, value in vars(alone).items() if value != getattr(spec.appearance, name)
        ]
        assert changed
        assert all(getattr(alone, name) == getattr(together, name) for name in changed)


def test_nothing_but_images_changes() -> None:
    plain = next(record(Recording.of(image_size=32), [3]))
    varied = next(record(Recording.of(image_size=32, appearance=tuple(RANDOMIZATIONS)), [3]))
    for name in ("state", "action", "target_pose_h", "target_contacts"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(varied, name))
    assert plain.meta.task == varied.meta.task
    assert np.abs(plain.images["ego"].astype(int) - varied.images["ego"]).mean() > 5


def test_distractors_stand_behind_the_targets_path(few: list[EpisodeSpec]) -> None:
    for spec in few:
        things = randomize_appearance(spec, ["distractors"]).appearance.distractors
        assert 1 <= len(things) <= 4
        assert all(
            thing.pos_w[0] - max(thing.half_size) > spec.target_path_w[:, 0].max()
            for thing in things
        )


def test_translucent_targets_are_blended_with_what_is_behind(few: list[EpisodeSpec]) -> None:
    """Without soft light: a translucent target also casts a paler shadow, and smooth edges blend
    once more.
    """

    def seen(alpha: float) -> np.ndarray:
        varied = [
            replace(spec, appearance=replace(spec.appearance, target_alpha=alpha)) for spec in few
        ]
        return images(varied, "flat")

    solid = seen(1.0)
    behind = seen(0.0)
    assert np.abs(seen(0.4) - (0.4 * solid + 0.6 * behind)).max() < 3


def test_every_seed_has_its_own_furniture(specs: list[EpisodeSpec]) -> None:
    assert all(furnish(spec).appearance == spec.appearance for spec in specs[:22]), (
        "it is a function of the episode"
    )
    rooms = {spec.appearance.furniture for spec in specs[:22]}
    assert len(rooms) >= 20
    assert np.median([len(room) for room in rooms]) >= 5
    assert max(len(room) for room in rooms) <= FURNITURE_SLOTS
    behind = [
        sum(solid.pos_w[0] < spec.home_pos_w[0] for solid in spec.appearance.furniture)
        for spec in specs[:22]
    ]
    assert min(behind) >= 3, "the second camera looks backwards"


def test_furniture_stands_in_the_room_and_clear_of_the_path(specs: list[EpisodeSpec]) -> None:
    for spec in specs[:44]:
        low = spec.target_path_w.min(axis=0) - 0.3
        high = spec.target_path_w.max(axis=0) + 0.3
        for solid in spec.appearance.furniture:
            pos = np.asarray(solid.pos_w)
            half = np.asarray(solid.half_size)
            assert (np.abs(pos[:2]) + half[:2] <= ARENA_HALF_M + 1e-6).all()
            assert (pos - half > high).any() or (pos + half < low).any(), spec.motion.name


def test_furniture_hides_no_target(specs: list[EpisodeSpec]) -> None:
    bare = [replace(spec, appearance=replace(spec.appearance, furniture=())) for spec in specs[:22]]
    views = []
    for some in (specs[:22], bare):
        batch = world(some, image_size=96, views=("side",))
        wait(batch)
        labels = [
            batch.cameras._renderer(camera).segmentation(np.arange(22))
            for camera in ("ego", "side")
        ]
        views.append(np.isin(labels, batch.scene.target_geoms))
    assert views[1].any(axis=(2, 3)).mean() > 0.8
    np.testing.assert_array_equal(views[0], views[1])
