"""What the ray casters show is what is there, in the colors it has."""

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
"""Least cosine between a median color and the tint it should have: shading changes its brightness,
not its hue."""


@pytest.fixture(scope="module", params=["tiles", "warp"])
def watching(request: pytest.FixtureRequest, specs: list[EpisodeSpec]) -> WorldBatch:
    """One world for each kind, at the start of its control phase; tests must not step it."""
    batch = world(specs[:22], image_size=SIZE, renderer=request.param)
    wait(batch)
    return batch


@pytest.fixture(scope="module")
def images(watching: WorldBatch) -> np.ndarray:
    return watching.cameras.render()


def test_things_have_their_colors_where_the_labels_say_they_are(watching, images, specs):
    labels = watching.cameras.segmentation()
    scene = watching.scene
    compared = dict.fromkeys(("target", "skin", "floor", "wall"), 0)
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
                color = np.median(pixels, axis=0)
                tint = np.array(getattr(spec.appearance, f"{thing}_rgb"))
                cosine = color @ tint / np.linalg.norm(color) / np.linalg.norm(tint)
                assert cosine > SAME_HUE, (spec.motion.name, thing)
                compared[thing] += 1
    assert min(compared.values()) >= 12


def test_worlds_that_are_not_asked_for_are_black_and_the_others_unchanged(
    watching: WorldBatch, images: np.ndarray
):
    some = watching.cameras.render(np.array([4, 17]))
    np.testing.assert_array_equal(some[[4, 17]], images[[4, 17]])
    assert not np.delete(some, [4, 17], axis=0).any()


def test_a_shape_it_cannot_draw_is_refused(specs: list[EpisodeSpec]) -> None:
    batch: WorldBatch = world(specs[:1])
    geom = int(np.flatnonzero(np.isin(batch.scene.model.geom_group, SHOWN_GROUPS))[0])
    kind = batch.scene.model.geom_type[geom]
    batch.scene.model.geom_type[geom] = mujoco.mjtGeom.mjGEOM_MESH.value
    try:
        with pytest.raises(
            ValueError, match=r"'tiles' cannot draw MuJoCo's geom types \[7\]; use 'warp'"
        ):
            RENDERERS["tiles"](batch.scene, batch._batch, 32, EGO_VIEW)
    finally:
        batch.scene.model.geom_type[geom] = kind
