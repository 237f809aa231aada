"""A policy that has learned nothing, for recordings in which it moves the hand."""

from __future__ import annotations

from pathlib import Path

import pytest
from lerobot_policy_tracker.learner import make_learner

from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe, read_recipe
from tests.onpolicy.test_dagger import tiny_recipe


@pytest.fixture(scope="session")
def actor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint of a tiny tracker for images of 32 pixels."""
    folder = tmp_path_factory.mktemp("actor")
    make_learner(read_recipe(DaggerRecipe, tiny_recipe(folder))).save_pretrained(folder / "checkpoint")
    return folder / "checkpoint"
