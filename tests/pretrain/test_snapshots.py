"""Images of random poses show the target where they say it is."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot_policy_obact.camera import Pinhole

from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.pretrain.recipe import PretrainRecipe
from dynahoi_lerobot.pretrain.snapshots import ImageStream, calibration, shown_specs, snapshots
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

RECIPE = Recipe.of(image_size=64)
SPECS = sample_specs(RECIPE, range(8))


@pytest.mark.parametrize("camera", ["ego", "side"])
def test_the_calibration_is_that_of_the_camera(tmp_path: Path, camera: str):
    """A ball that is posed where the calibration puts (u, v) is drawn around that point of the
    image.
    """
    recipe = PretrainRecipe(tmp_path, camera, episodes=RECIPE, n_episodes=1)
    pose, (focal_px, _, center_px, _) = calibration(recipe)
    eye = Pinhole.from_pose(pose.tolist(), center_px / focal_px, carried=camera == "ego")
    wanted = torch.tensor([[0.0, 0.0, 0.0], [-0.6, 0.5, 0.2], [0.7, 0.4, -0.4], [-0.3, 0.8, 0.5]])
    batch = WorldBatch(RECIPE.rules, len(wanted), threads=1)
    batch.reset(
        np.arange(len(wanted)), sample_specs(replace(RECIPE, objects=("ball",)), range(len(wanted)))
    )
    state = batch.state + np.eye(18)[2] * 0.05
    place = eye.origin(torch.from_numpy(state[:, :3])) + eye.unproject(wanted)
    pose = np.concatenate([place, np.tile((1.0, 0.0, 0.0, 0.0), (len(wanted), 1))], axis=1)
    batch.place(state, pose)
    seen = batch.cameras._renderer(camera).segmentation(np.arange(len(wanted)))
    target = np.isin(seen, batch.scene.target_geoms)  # (N, H, W)
    for mask, (u, v, _) in zip(target, wanted.tolist(), strict=True):
        row, column = (2 * (np.argwhere(mask).mean(axis=0) + 0.5) / 64 - 1).tolist()
        assert (column, -row) == pytest.approx((u, v), abs=0.02), "to two thirds of a pixel"


def test_the_target_is_where_they_say_fingers_move_and_some_images_come_twice(
    monkeypatch: pytest.MonkeyPatch,
):
    placed: list[np.ndarray] = []
    batch = WorldBatch(RECIPE.rules, 32, threads=1)
    place = WorldBatch.place

    def watched(self: WorldBatch, hand: np.ndarray, pose: np.ndarray) -> None:
        placed.append(np.hstack([hand, pose, self.home_pos_w]))
        place(self, hand, pose)

    monkeypatch.setattr(WorldBatch, "place", watched)
    shown = list(islice(snapshots(batch, SPECS, np.random.default_rng(0)), 8))
    now = np.concatenate(placed[0::2])  # (256, 28)
    before = np.concatenate(placed[1::2])
    places = np.concatenate([s.place for s in shown])
    np.testing.assert_allclose(places, now[:, 18:21] - now[:, :3], atol=1e-6)
    assert len(np.unique(places, axis=0)) > 190, (
        "some are from home, and there a target that rests is where it was"
    )
    assert np.ptp(places, axis=0).min() > 0.2, (
        "targets near and far, left and right, above and below"
    )
    assert (now[:, 2] + now[:, 27] > 0.049).all(), "no palm is in the floor"
    joints = np.abs(now[:, 3:18])
    joints_before = np.abs(before[:, 3:18])
    moving = np.abs(now - before)[:, 3:18].max(axis=1) > 1e-3
    closing = (joints.sum(axis=1) > joints_before.sum(axis=1)) & moving
    assert 0.2 < moving.mean() < 0.4
    assert closing.sum() > 1.5 * (moving.sum() - closing.sum()), "hands close faster than they open"
    images = np.concatenate([s.images for s in shown])
    twice = (images[..., :3] == images[..., 3:]).all(axis=(1, 2, 3))
    assert 0 < twice.mean() < 0.15


def test_a_share_of_the_episodes_is_randomised(tmp_path: Path):
    def surroundings(share: float) -> int:
        """Return how many of four episodes have distractors."""
        recipe = PretrainRecipe(tmp_path, episodes=RECIPE, n_episodes=4, randomized_share=share)
        return sum(
            bool(spec.appearance.distractors) for spec in shown_specs(recipe, RECIPE, range(4))
        )

    assert [surroundings(share) for share in (0.0, 0.5, 1.0)] == [0, 2, 4]


def test_hands_take_turns(tmp_path: Path):
    hands = ("capsule", "opposed")
    recipe = PretrainRecipe(
        tmp_path, episodes=RECIPE, hands=hands, n_episodes=2, batch_size=2, images=2
    )
    stream = ImageStream(recipe)(0)
    recipes = [changed(RECIPE, {"hand": hand}) for hand in recipe.hands]
    rng = np.random.default_rng([recipe.seed, 0, 0])
    alone = [
        snapshots(WorldBatch(one.rules, 2, threads=1), shown_specs(recipe, one, range(2)), rng)
        for one in recipes
    ]
    for one in alone:
        np.testing.assert_array_equal(next(stream).images, next(one).images)
