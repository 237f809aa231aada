"""Protocol ``observe_then_blind``: the same episodes, black from the first control frame on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

SEEING = Recipe(split="test", image_size=16, views=("side",))
BLIND = replace(SEEING, protocol="observe_then_blind")


def played(recipe: Recipe) -> list:
    specs = sample_specs(recipe, range(6))
    episodes = evaluate(WorldBatch(recipe, 3), EXPERTS[recipe.expert](), specs, images=True)
    return sorted(episodes, key=lambda episode: episode.meta.seed)


def test_the_cameras_see_the_window_and_nothing_after_it():
    for seeing, blind in zip(played(SEEING), played(BLIND), strict=True):
        assert blind.success
        np.testing.assert_array_equal(blind.state, seeing.state)
        window = blind.meta.window_frames
        for view in ("ego", "side"):
            np.testing.assert_array_equal(blind.images[view][:window], seeing.images[view][:window])
            assert seeing.images[view][window:].any(axis=(1, 2, 3)).all()
            assert not blind.images[view][window:].any()


def test_a_model_without_memory_is_refused(capsys: pytest.CaptureFixture):
    words = ["evaluate", "--policy", "vlm", "--model", "m", "--protocol", "observe_then_blind"]
    assert main(words) == 2
    assert "decides by what it sees while acting, which is nothing under observe_then_blind" in capsys.readouterr().err
