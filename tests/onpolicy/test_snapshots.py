"""Pictures of random poses show the target where they say it is."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
import torch
from lerobot_policy_obact.backbones.eye import EyeBackbone

from dynahoi_lerobot.onpolicy.snapshots import snapshots
from dynahoi_lerobot.rollout.loop import make_batch
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

RECIPE = Recipe(image_size=64)
SPECS = sample_specs(RECIPE, range(8))


def test_the_same_draws_give_the_same_pictures_and_others_do_not():
    first, again, other = (next(snapshots(RECIPE, SPECS, 4, np.random.default_rng(seed))) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.images, again.images)
    np.testing.assert_array_equal(first.offset, again.offset)
    assert (first.offset != other.offset).any()


def test_pictures_are_of_many_poses():
    shown = list(islice(snapshots(RECIPE, SPECS, 4, np.random.default_rng(0)), 10))
    offsets = np.concatenate([s.offset for s in shown])
    assert len(offsets) == 40
    assert len(np.unique(offsets, axis=0)) > 30, "some are from home, and there a target that rests is where it was"
    assert np.ptp(offsets, axis=0).min() > 0.2, "targets near and far, left and right, above and below"


def test_the_eye_has_the_geometry_of_the_camera():
    """A target that is posed where the eye's geometry puts (u, v) is drawn around that point of the image."""
    eye = EyeBackbone(16)
    wanted = torch.tensor([[0.0, 0.0, 0.0], [-0.6, 0.5, 0.2], [0.7, 0.4, -0.4], [-0.3, 0.8, 0.5]])
    offset = eye.offset(wanted).numpy()
    batch = make_batch(RECIPE, len(wanted), threads=1)
    batch.reset(np.arange(len(wanted)), SPECS[: len(wanted)])
    state = batch.state.copy()
    pose = np.concatenate([state[:, :3] + offset, np.tile((1.0, 0.0, 0.0, 0.0), (len(wanted), 1))], axis=1)
    batch.place(state, pose)
    target = np.isin(batch.cameras.segmentation(), batch.scene.target_geoms)  # (N, H, W)
    for mask, (u, v, _) in zip(target, wanted.tolist(), strict=True):
        row, column = (2 * (np.argwhere(mask).mean(axis=0) + 0.5) / 64 - 1).tolist()
        assert (column, -row) == pytest.approx((u, v), abs=0.08)
