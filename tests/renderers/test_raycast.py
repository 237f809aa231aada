"""What the ray casters show is what is there, in the colours it has, and as mujoco_warp draws it."""

import mujoco
import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.renderers import RENDERERS
from dynahoi_lerobot.scene.model import SHOWN_GROUPS
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import wait, world

SIZE = 64
SAME_HUE = 0.95
"""Least cosine between a median colour and the tint it should have: shading changes its brightness, not its hue."""


@pytest.fixture(scope="module", params=["tiles", "warp"])
def watching(request: pytest.FixtureRequest, specs: list[EpisodeSpec]) -> WorldBatch:
    """One world for each kind, at the start of its control phase; tests must not step it."""
    batch = world(specs[:22], image_size=SIZE, renderer=request.param)
    wait(batch)
    return batch


@pytest.fixture(scope="module")
def images(watching: WorldBatch) -> np.ndarray:
    return watching.cameras.render()


@pytest.fixture(scope="module")
def labels(watching: WorldBatch) -> np.ndarray:
    return watching.cameras.segmentation()


def test_images_have_the_promised_shape_and_content(images: np.ndarray):
    assert images.shape == (22, SIZE, SIZE, 3)
    assert images.dtype == np.uint8
    assert len({image.tobytes() for image in images}) == 22
    assert (images.reshape(22, -1).std(axis=1) > 10).all(), "no image is blank"


def test_things_have_their_colours_where_the_labels_say_they_are(watching, images, labels, specs):
    scene, compared = watching.scene, dict.fromkeys(("target", "skin", "floor", "wall"), 0)
    geoms = {
        "target": scene.target_geoms,
        "skin": np.concatenate([scene.hand_geoms, scene.skin_geoms]),
        "floor": [scene.floor_geom],
        "wall": scene.wall_geoms,
    }
    for spec, image, seen in zip(specs, images, labels, strict=False):
        for thing, ids in geoms.items():
            pixels = image[np.isin(seen, ids)]
            if len(pixels) >= (8 if thing == "target" else 50):  # a table may cover the floor
                # the median, as pixels on edges hold some of what is behind
                colour, tint = np.median(pixels, axis=0), np.array(getattr(spec.appearance, f"{thing}_rgb"))
                cosine = colour @ tint / np.linalg.norm(colour) / np.linalg.norm(tint)
                assert cosine > SAME_HUE, (spec.motion.name, thing)
                compared[thing] += 1
    assert min(compared.values()) >= 12


def test_worlds_that_are_not_asked_for_are_black_and_the_others_unchanged(watching: WorldBatch, images: np.ndarray):
    some = watching.cameras.render(np.array([4, 17]))
    np.testing.assert_array_equal(some[[4, 17]], images[[4, 17]])
    assert not np.delete(some, [4, 17], axis=0).any()


ODD_SIZE = 72
"""Not a multiple of a tile's side, so that the last tiles stick out [px]."""
FRAMES = (0, 9, 30)
"""The hand closes in between, so that shapes come near the camera."""
MOST_DIFFERENT = 2e-4
"""Share of pixels, on edges of shapes, that rounding may give to either side."""
VISIBLE = 2
"""Grey levels of 255."""


def play(specs: list[EpisodeSpec], renderer: str, threads: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return images (F, N, H, W, 3) and labels (F, N, H, W) while the hand closes."""
    batch = world(specs, image_size=ODD_SIZE, threads=threads, renderer=renderer)
    images, labels = [], []
    for frame in range(max(FRAMES) + 1):
        if frame in FRAMES:
            images.append(batch.cameras.render())
            labels.append(batch.cameras.segmentation())
        commands = batch.executed.copy()
        commands[:, 3:] += 0.05
        batch.step(np.clip(commands, *batch.commands.limits()))
    return np.stack(images), np.stack(labels)


@pytest.fixture(scope="module")
def drawn(specs: list[EpisodeSpec]) -> tuple[np.ndarray, np.ndarray]:
    return play(specs[:22], "tiles")


def test_without_soft_light_it_draws_what_mujoco_warp_draws(drawn, specs):
    """``flat`` is the same ray caster with shadows, soft light, filtering and smooth edges switched off."""
    flat, flat_labels = play(specs[:22], "flat")
    images, labels = play(specs[:22], "warp")
    difference = np.abs(images.astype(int) - flat).max(axis=-1)
    assert images.std(axis=(2, 3, 4)).min() > 5.0
    assert (difference > VISIBLE).mean() < MOST_DIFFERENT
    assert (labels != flat_labels).mean() < MOST_DIFFERENT
    assert len(np.unique(labels)) > 30, "many geoms were seen"
    np.testing.assert_array_equal(drawn[1], flat_labels, "soft light changes no label")


def test_threads_and_neighbours_do_not_change_a_byte(drawn: tuple[np.ndarray, np.ndarray], specs) -> None:
    np.testing.assert_array_equal(play(specs[:22], "tiles", threads=3)[0], drawn[0])
    alone, _ = play(specs[7:8], "tiles")
    np.testing.assert_array_equal(alone[:, 0], drawn[0][:, 7])


def test_a_shape_it_cannot_draw_is_refused(specs: list[EpisodeSpec]) -> None:
    batch: WorldBatch = world(specs[:1])
    geom = int(np.flatnonzero(np.isin(batch.scene.model.geom_group, SHOWN_GROUPS))[0])
    kind = batch.scene.model.geom_type[geom]
    batch.scene.model.geom_type[geom] = mujoco.mjtGeom.mjGEOM_MESH.value
    try:
        with pytest.raises(ValueError, match=r"'tiles' cannot draw MuJoCo's geom types \[7\]; use 'warp'"):
            RENDERERS["tiles"](batch.scene, batch._batch, 32, EGO_VIEW)
    finally:
        batch.scene.model.geom_type[geom] = kind
