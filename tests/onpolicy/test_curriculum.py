"""Which episodes are played: new ones first, then those of kinds that fail, and the same again after a restart."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.experts.baselines import Hold
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.onpolicy.curriculum import Curriculum
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.world.batch import WorldBatch

KINDS = ("lob", "vertical")


def curriculum() -> Curriculum:
    recipe = DaggerRecipe(Path("unused"), {}, episodes=Recipe(motions=KINDS), worlds=4, n_episodes=8)
    return Curriculum(recipe, np.random.default_rng(0))


def test_every_episode_is_played_once_before_any_is_played_again():
    some = curriculum()
    seeds = [spec.seed for number in range(2) for spec in some.episodes(number)]
    assert seeds == list(range(8))
    assert {spec.seed for spec in some.episodes(2)} <= set(seeds)


@pytest.mark.slow
def test_kinds_that_fail_come_more_often():
    some = curriculum()
    lobs, verticals = some.episodes(0)[::2], some.episodes(0)[1::2]
    assert len(set(some.failure_rates().values())) == 1
    batch = WorldBatch(Recipe(), 2, threads=1)
    for _ in range(20):
        some.note([*evaluate(batch, Hold(), lobs), *evaluate(batch, Intercept(), verticals)])
    rates = some.failure_rates()
    assert rates["lob"] > 0.9
    assert rates["vertical"] < 0.1
    drawn = Counter(spec.motion.name for number in range(2, 42) for spec in some.episodes(number))
    assert drawn["lob"] > 1.1 * drawn["vertical"]


def test_what_is_known_of_kinds_survives_a_restart():
    some, other = curriculum(), curriculum()
    some.note(evaluate(WorldBatch(Recipe(), 2, threads=1), Hold(), some.episodes(0)[:2]))
    assert other.failure_rates() != some.failure_rates()
    other.load_state_dict(some.state_dict())
    assert other.failure_rates() == some.failure_rates()
