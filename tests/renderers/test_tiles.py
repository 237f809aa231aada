"""The ray caster made for this scene draws what mujoco_warp's general one draws, whoever shares the work."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.renderers import RENDERERS
from dynahoi_lerobot.scene.model import SHOWN_GROUPS
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import world

SIZE = 72
"""Not a multiple of a tile's side, so that the last tiles stick out [px]."""
FRAMES = (0, 9, 30)
"""The hand closes in between, so that shapes come near the camera."""
MOST_DIFFERENT = 2e-4
"""Share of pixels, on edges of shapes, that rounding may give to either side."""
VISIBLE = 2
"""Grey levels of 255."""


def play(specs: list[EpisodeSpec], renderer: str, threads: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return pictures (F, N, H, W, 3) and labels (F, N, H, W) while the hand closes."""
    batch = world(specs, image_size=SIZE, threads=threads, renderer=renderer)
    pictures, labels = [], []
    for frame in range(max(FRAMES) + 1):
        if frame in FRAMES:
            pictures.append(batch.cameras.render())
            labels.append(batch.cameras.segmentation())
        commands = batch.executed.copy()
        commands[:, 3:] += 0.05
        batch.step(np.clip(commands, *batch.command_limits()))
    return np.stack(pictures), np.stack(labels)


@pytest.fixture(scope="module")
def drawn(specs: list[EpisodeSpec]) -> tuple[np.ndarray, np.ndarray]:
    return play(specs[:22], "tiles")


def test_without_soft_light_it_draws_what_mujoco_warp_draws(
    drawn: tuple[np.ndarray, np.ndarray], specs: list[EpisodeSpec]
) -> None:
    """``flat`` is the same ray caster with shadows, soft light, filtering and smooth edges switched off."""
    flat, flat_labels = play(specs[:22], "flat")
    pictures, labels = play(specs[:22], "warp")
    difference = np.abs(pictures.astype(int) - flat).max(axis=-1)
    assert pictures.std(axis=(2, 3, 4)).min() > 5.0
    assert (difference > VISIBLE).mean() < MOST_DIFFERENT
    assert (labels != flat_labels).mean() < MOST_DIFFERENT
    assert len(np.unique(labels)) > 30, "many geoms were seen"
    np.testing.assert_array_equal(drawn[1], flat_labels, "soft light changes no label")


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_do_not_change_a_byte(
    drawn: tuple[np.ndarray, np.ndarray], specs: list[EpisodeSpec], threads: int
) -> None:
    np.testing.assert_array_equal(play(specs[:22], "tiles", threads)[0], drawn[0])


def test_neighbours_do_not_change_a_byte(drawn: tuple[np.ndarray, np.ndarray], specs: list[EpisodeSpec]) -> None:
    alone, _ = play(specs[7:8], "tiles")
    np.testing.assert_array_equal(alone[:, 0], drawn[0][:, 7])


def test_a_shape_it_cannot_draw_is_refused(specs: list[EpisodeSpec]) -> None:
    batch: WorldBatch = world(specs[:1])
    geom = int(np.flatnonzero(np.isin(batch.scene.model.geom_group, SHOWN_GROUPS))[0])
    kind = batch.scene.model.geom_type[geom]
    batch.scene.model.geom_type[geom] = mujoco.mjtGeom.mjGEOM_MESH.value
    try:
        with pytest.raises(ValueError, match=r"'tiles' cannot draw MuJoCo's geom types \[7\]; use 'warp'"):
            RENDERERS["tiles"](batch.scene, batch._batch, 32)
    finally:
        batch.scene.model.geom_type[geom] = kind
