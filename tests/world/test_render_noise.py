"""Render noise changes what is seen, by a few levels, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

CLEAN = Recipe(split="test", image_size=16, views=("side",))
NOISY = replace(CLEAN, render_noise=2)


def played(recipe: Recipe, size: int = 2) -> list[Episode]:
    specs = sample_specs(recipe, range(3))
    episodes = evaluate(WorldBatch(recipe, size), EXPERTS[recipe.expert](), specs, images=True)
    return sorted(episodes, key=lambda episode: episode.meta.seed)


def test_every_image_changes_by_up_to_the_given_levels_and_nothing_else_does():
    for clean, noisy in zip(played(CLEAN), played(NOISY), strict=True):
        np.testing.assert_array_equal(noisy.state, clean.state)
        for view in ("ego", "side"):
            change = noisy.images[view].astype(int) - clean.images[view]
            within = change[(clean.images[view] > 2) & (clean.images[view] < 253)]
            assert set(np.unique(within)) == {-2, -1, 0, 1, 2}
            assert abs(within.mean()) < 0.1
            assert (change != 0).any(axis=(1, 2, 3)).all()
            assert not np.array_equal(change[0], change[1])


def test_black_images_stay_black():
    for episode in played(replace(NOISY, protocol="observe_then_blind")):
        assert not episode.images["ego"][episode.meta.window_frames :].any()
