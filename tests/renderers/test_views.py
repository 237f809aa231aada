"""Every view shows the same worlds, whoever draws them; depth is a distance, segmentation names
what is there.
"""

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import EGO_VIEW
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.env.vector_env import DynahoiVectorEnv
from dynahoi_lerobot.renderers.views import COLORS, DEPTH_LEVEL_M, EXTRA_VIEWS
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.scene.model import LARGEST_SLOT_M
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import world

SIZE = 72
"""Not a multiple of a tile's side, so that the last tiles stick out [px]."""
MOST_DIFFERENT = 2e-3
"""Share of pixels, on edges of shapes, that rounding may give to either side."""
LEVELS = 2


@pytest.fixture(scope="module")
def batch(specs: list[EpisodeSpec]) -> WorldBatch:
    return world(specs[:22:3], image_size=SIZE, views=EXTRA_VIEWS)


@pytest.mark.parametrize("frames", [0, 30])
def test_without_soft_light_tiles_draw_what_mujoco_warp_draws(
    frames: int, specs: list[EpisodeSpec]
) -> None:
    """Also when the hand has closed, so that shapes are near the camera."""
    flat, soft, warp = (
        world(specs[:22:3], image_size=SIZE, renderer=name) for name in ("flat", "tiles", "warp")
    )
    for batch in (flat, soft, warp):
        for _ in range(frames):
            batch.step(batch.executed + np.r_[np.zeros(3), np.full(15, 0.05)])
    for view in (EGO_VIEW, *EXTRA_VIEWS):
        ours = flat.cameras.render(view=view).astype(int)
        theirs = warp.cameras.render(view=view)
        if view not in (EGO_VIEW, "side"):
            np.testing.assert_array_equal(
                soft.cameras.render(view=view), ours, "soft light changes no label"
            )
        assert (np.abs(ours - theirs).max(axis=-1) > LEVELS).mean() < MOST_DIFFERENT, view
        assert ours.std(axis=(1, 2, 3)).min() > 5.0, view


def test_depth_is_the_distance_along_the_axis(batch: WorldBatch) -> None:
    """The target's nearest pixel lies before its center, by no more than the largest object is
    wide.
    """
    labels = batch.cameras.segmentation()
    depth = batch.cameras.depth()
    camera = batch._batch.bind("cam_xpos")[:, batch.scene.camera]
    axis = -batch._batch.bind("cam_xmat")[:, batch.scene.camera].reshape(-1, 3, 3)[:, :, 2]
    center = ((batch.target_pose_h[:, :3] + batch.home_pos_w - camera) * axis).sum(axis=1)
    seen = 0
    for i in range(batch.size):
        on_target = depth[i][np.isin(labels[i], batch.scene.target_geoms)]
        if len(on_target) > 10:
            seen += 1
            assert 0.0 < center[i] - on_target.min() < LARGEST_SLOT_M
    assert seen > 3


def test_images_of_depth_and_segmentation(batch: WorldBatch) -> None:
    images = batch.observe(images=True).images
    metres = batch.cameras.depth()
    grey = images["ego_depth"][..., 0]
    near = (metres > 0) & (metres < 2.5)
    assert near.any()
    np.testing.assert_allclose(grey[near] * DEPTH_LEVEL_M, metres[near], atol=DEPTH_LEVEL_M)
    assert (grey[metres == 0] == 255).all()
    is_target = np.isin(batch.cameras.segmentation(), batch.scene.target_geoms)
    assert (images["ego_segmentation"][is_target] == COLORS["target"]).all()
    assert not (images["ego_segmentation"][~is_target] == COLORS["target"]).all(axis=-1).any()
    for thing in ("hand", "target"):
        assert (images["side_segmentation"] == COLORS[thing]).all(axis=-1).any(
            axis=(1, 2)
        ).mean() > 0.7


def test_motion_shows_the_frames_two_and_four_before_in_its_channels(
    specs: list[EpisodeSpec],
) -> None:
    recording = Recording.of(split=specs[0].split, image_size=32, views=("ego_motion",))
    one, *_ = episodes = list(
        record(recording, [specs[0].seed, specs[1].seed, specs[2].seed], batch_size=2)
    )
    luminance = [0.299, 0.587, 0.114]
    for episode in episodes:
        grey = episode.images["ego"] @ luminance
        for channel, before in enumerate((0, 2, 4)):
            seen = episode.images["ego_motion"][..., channel]
            then = np.maximum(np.arange(len(episode)) - before, 0)
            assert np.abs(seen - grey[then]).max() <= 1.0
    (alone,) = record(recording, [one.meta.seed], batch_size=1)
    np.testing.assert_array_equal(alone.images["ego_motion"], one.images["ego_motion"])
    env = DynahoiVectorEnv(1, image_size=32, views=("ego_motion",))
    assert env.reset(seed=0)[0]["pixels"]["ego_motion"].shape == (1, 32, 32, 3)
    assert env.observation_space.contains(env.reset(seed=0)[0])
