"""Failed episodes as an option of generation: kept, marked, the same however they are made."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.generate import command
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.verify.command import verify
from tests.generate.test_with_simulator import run

MOTIONS = ("constant", "lob", "depth", "planar")
RECIPE = Recipe(expert="pursuit", motions=MOTIONS, image_size=16, keep_failures=True)
EPISODES = 12


def plan(**changes) -> GenerationPlan:
    return GenerationPlan(**({"recipe": RECIPE, "episodes": EPISODES, "shard_episodes": 5} | changes))


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    """Episodes of a pursuer that is too slow for some of them."""
    root = tmp_path_factory.mktemp("kept") / "d"
    generate(plan(), root, record=record)
    return root


def episode_table(root: Path) -> pd.DataFrame:
    return pd.read_parquet(root / "meta/episodes")


def test_failures_are_kept_in_their_place_and_marked(kept):
    manifest, table = Manifest.read(kept), episode_table(kept)
    assert manifest.seeds == list(range(EPISODES)), "nothing is drawn again"
    failed = int((~table["success"]).sum())
    assert 0 < failed < EPISODES
    assert manifest.yields == {"tried": EPISODES, "kept": EPISODES, "failed": failed, "missed": 0, "rejected": 0}
    for episode in read_episodes(kept, images=False):
        assert episode.reward.sum() == episode.success
        assert episode.succeeded[-1] == episode.success
        assert episode.attempt_success.tolist() == [episode.success]
    assert verify(kept, replayed=3) == []


def test_by_default_they_are_drawn_again(tmp_path):
    generate(plan(recipe=Recipe(expert="pursuit", motions=MOTIONS, image_size=16)), tmp_path / "d", record=record)
    manifest = Manifest.read(tmp_path / "d")
    assert episode_table(tmp_path / "d")["success"].all()
    assert manifest.yields["missed"] > 0 == manifest.yields["failed"]


def test_datasets_with_and_without_failures_merge(kept, tmp_path):
    generate(plan(recipe=Recipe(motions=MOTIONS, image_size=16), seed=100), tmp_path / "other", record=record)
    manifest = merge([kept, tmp_path / "other"], tmp_path / "both")
    success = episode_table(tmp_path / "both")["success"].tolist()
    assert success == [*episode_table(kept)["success"], *[True] * EPISODES]
    assert manifest.yields["failed"] == success.count(False)


def test_all_attempts_at_a_failed_episode_are_told(tmp_path):
    recipe = Recipe(image_size=0, motions=("bounce", "lob"), perturbed_share=1.0, keep_failures=True)
    generate(GenerationPlan(recipe, 8), tmp_path / "d", record=record)
    attempts = episode_table(tmp_path / "d")["stats/attempt_success"].map(list).tolist()
    assert max(map(len, attempts)) > 1, "the expert begins again"
    assert all(not any(tries[:-1]) for tries in attempts)
    assert verify(tmp_path / "d", replayed=2) == []


def test_the_option_of_the_command(tmp_path, capsys):
    (tmp_path / "recipe.yaml").write_text("expert: hold\n")
    words = ("--root", tmp_path / "d", "--episodes", 2, "--image-size", 0, "--motions", "constant,lob")
    assert run(command, *words, "--recipe", tmp_path / "recipe.yaml", "--keep-failures") == 0
    assert '"failed": 2' in capsys.readouterr().out
    assert Manifest.read(tmp_path / "d").provenance["recipe"]["keep_failures"] is True
