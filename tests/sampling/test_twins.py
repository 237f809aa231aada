"""Speed twins: the same episode in all that can be drawn, its target on the same path, at another speed."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import CONTROL_DT
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.motions import MOTIONS, PrescribedMotion
from dynahoi_lerobot.rollout.loop import evaluate, record
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.homes import visible
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

SLOW, FAST = (Recipe(split="twins", path_speed=speed) for speed in (1.0, 1.6))
N_KINDS = len(SLOW.motion_names)
DIFFERENT = {"motion", "oracle_path", "fingerprint"}


@pytest.fixture(scope="module")
def pairs() -> list[tuple[EpisodeSpec, EpisodeSpec]]:
    """Every kind twice, at both speeds."""
    return list(zip(*(sample_specs(recipe, range(2 * N_KINDS)) for recipe in (SLOW, FAST)), strict=True))


def test_every_kind_whose_path_is_prescribed_has_twins():
    prescribed = {name for name in BENCHMARK.splits["train"].motions if issubclass(MOTIONS[name], PrescribedMotion)}
    assert set(SLOW.motion_names) == prescribed
    assert BENCHMARK.splits["twins"].size % N_KINDS == 0


def test_nothing_but_the_speed_differs(pairs: list[tuple[EpisodeSpec, EpisodeSpec]]):
    for slow, fast in pairs:
        for field in fields(EpisodeSpec):
            if field.name not in DIFFERENT:
                np.testing.assert_equal(getattr(slow, field.name), getattr(fast, field.name), field.name)
        assert (slow.motion.name, slow.motion.phrase) == (fast.motion.name, fast.motion.phrase)
        assert slow.motion.motion == fast.motion.motion


def test_the_target_is_on_the_same_path_faster_and_at_the_intercept_in_the_same_frame(
    pairs: list[tuple[EpisodeSpec, EpisodeSpec]],
):
    for slow, fast in pairs:
        meeting_s = slow.intercept_frame * CONTROL_DT
        later_s = np.linspace(-0.3, 0.3, 7)
        np.testing.assert_allclose(
            fast.motion.position(meeting_s + later_s), slow.motion.position(meeting_s + 1.6 * later_s), atol=1e-9
        )
        for spec in (slow, fast):
            assert np.linalg.norm(spec.oracle_path[spec.intercept_frame] - slow.intercept_pos_w) < 1e-9


def test_both_can_be_watched_and_met_alike(pairs: list[tuple[EpisodeSpec, EpisodeSpec]]):
    for spec in (spec for pair in pairs for spec in pair):
        seen = visible(spec.oracle_path[: spec.window_frames + 1] - spec.home_pos_w)
        assert seen.mean() >= 0.9
    episodes = list(evaluate(WorldBatch(FAST, 12), EXPERTS["intercept"](), [fast for _, fast in pairs]))
    assert np.mean([episode.success for episode in episodes]) > 0.9
    assert {episode.meta.split for episode in episodes} == {"twins"}


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"split": "test", "path_speed": 1.6}, "path_speed must be 1 in split 'test', got 1.6"),
        ({"split": "twins", "path_speed": 2.0}, "path_speed must be 1, 1.6 in split 'twins', got 2"),
        ({"split": "twins", "protocol": "occluded"}, "screens depend on the speed"),
        ({"split": "twins", "motions": ("lob",)}, "'lob'"),
    ],
)
def test_what_has_no_twins_is_refused(changes: dict, problem: str):
    with pytest.raises(ValueError, match=problem):
        Recipe(**changes)


def test_twins_are_not_recorded():
    with pytest.raises(ValueError, match="is for evaluations"):
        next(record(SLOW, [0]))
