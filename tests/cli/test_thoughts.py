"""What a policy thinks, drawn where it is."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from dynahoi_lerobot.cli.thoughts import SIGHTED, WIDTH_PX, drawn
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.renderers.views import COLORS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.checkpoints import tiny_diffusion
from tests.tools import dynahoi


def place(mask: np.ndarray) -> np.ndarray:
    """Mean row and column of a mask, in pixels of the enlarged image."""
    return np.argwhere(
        cv2.resize(mask.astype(np.uint8), (WIDTH_PX, WIDTH_PX), interpolation=0)
    ).mean(0)


@pytest.mark.parametrize("camera", ["ego", "side"])
def test_a_sighting_is_drawn_where_the_camera_shows_the_target(camera: str):
    view = f"{camera}_segmentation"
    recipe = Recipe.of(split="test", image_size=160, views=(view,))
    batch = WorldBatch(recipe.rules, 1)
    episode = next(evaluate(batch, EXPERTS["intercept"](), sample_specs(recipe, [0]), images=True))
    far = torch.full((1, 1, 3), -9.0)  # behind both cameras
    rest = {"forecast": far, "ahead_s": torch.zeros(1), "intercept": far[0]}
    rest["attention"] = torch.ones(1, 1, 1)
    thoughts = [
        SimpleNamespace(sighted=torch.tensor(pose[None, None, :3]), **rest)
        for pose in episode.target_pose_h
    ]
    page = drawn(episode, thoughts, batch, view)[0, :WIDTH_PX]
    target = place((episode.images[view][0] == COLORS["target"]).all(-1))
    cross = place((page == SIGHTED).all(-1))
    assert np.abs(cross - target).max() < 12, "most of a target is seen; the cross spans 22 pixels"


def test_a_policy_s_thoughts_become_a_film_at_the_size_it_was_trained_for(
    actor: Path, tmp_path: Path
):
    out = tmp_path / "lob.gif"
    words = ("--motion=lob", "--policy", actor, "--thoughts", "--out", out)
    assert f"{actor}: Catch" in dynahoi("view", *words).out
    with Image.open(out) as film:
        assert film.height > film.width > WIDTH_PX, "a strip of attention below"


def test_a_policy_without_thoughts_is_told_so(tmp_path: Path):
    folder = tiny_diffusion(tmp_path / "policy")
    words = ["--motion=lob", "--policy", folder, "--thoughts", "--environment-state=truth"]
    said = dynahoi("view", *words, "--out", tmp_path / "lob.gif", code=2).err
    assert "records nothing" in said
