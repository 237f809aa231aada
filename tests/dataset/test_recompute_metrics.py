"""Whoever has the parquet files gets the package's seven metrics, with a script that knows nothing
of the package.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.dataset import write_episodes
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.metrics import measure
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from tests import recompute_metrics
from tests.world.playing import played

SEVEN = ("S_loc", "S_gra", "E_loc", "E_gra", "Q_smooth", "Q_line", "R_time")
EPISODES = 11
"""Of half of the kinds of motion, as metrics know nothing of kinds."""
RECIPES = {
    "attach": Recording.of(expert="pursuit", keep_failures=True),
    "attach_lenient": Recording.of(capture="attach_lenient", expert="pursuit", keep_failures=True),
    "late": Recording.of(
        expert="constant_velocity", control_class="late", protocol="direct_act", keep_failures=True
    ),
    "contact": Recording.of(capture="contact", expert="pursuit", keep_failures=True),
}


def generated(recording: Recording, root: Path) -> list[Episode]:
    """Generate a dataset, and return its episodes as they were played."""
    kept: dict[int, Episode] = {}

    def remember(recording: Recording, seeds):
        for episode in record(recording, seeds):
            kept[episode.meta.seed] = episode
            yield episode

    first = (
        EPISODES if recording.recipe.rules.capture == "contact" else 0
    )  # of the episodes before that, it holds none
    manifest = generate(GenerationPlan(recording, EPISODES, first), root, record=remember)
    return [kept[seed] for seed in manifest.seeds]


def assert_same(root: Path, episodes: list[Episode]) -> None:
    values = [{name: measure(episode)[name] for name in SEVEN} for episode in episodes]
    wanted = pd.DataFrame(values).astype(float)
    np.testing.assert_allclose(
        recompute_metrics.metrics(root)[list(SEVEN)], wanted, rtol=0, atol=1e-6, equal_nan=True
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_a_dataset_with_failures_gives_the_same_metrics(name: str, tmp_path: Path) -> None:
    assert "dynahoi" not in Path(recompute_metrics.__file__).read_text(), (
        "it knows nothing of the package"
    )
    episodes = generated(changed(RECIPES[name], {"image_size": 0}), tmp_path / "d")
    assert {episode.success for episode in episodes} == {True, False}
    assert_same(tmp_path / "d", episodes)


def test_hands_that_stand_still_give_the_same_metrics(tmp_path: Path) -> None:
    recipe = Recipe.of(split="test", image_size=0)
    episodes = played(recipe.rules, EXPERTS["hold"](), sample_specs(recipe, range(4)))
    write_episodes(tmp_path / "d", episodes)
    assert_same(tmp_path / "d", episodes)
