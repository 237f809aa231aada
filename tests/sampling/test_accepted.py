"""What is shipped of the benchmark's episodes only saves time: the sampler draws the same without
it.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks import pin
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.sampling import accepted
from dynahoi_lerobot.sampling.accepted import ENTRIES, accepted_attempts
from dynahoi_lerobot.sampling.benchmark import BENCHMARK, BENCHMARK_ID
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_spec, sample_specs, search
from dynahoi_lerobot.sampling.splits import split_seeds

STREAMS = [name for name in BENCHMARK.streams if BENCHMARK.splits[name].size]
TEST = Recipe(split="test")
SEARCHED = 4
"""A seed whose first 33 attempts do not fit, at the 31st of which the timing is drawn again."""


def searched(recipe: Recipe, seeds: Sequence[int]) -> list[EpisodeSpec]:
    return [spec for _, spec in search(recipe, seeds)]


def stored() -> dict[str, np.ndarray]:
    with np.load(ENTRIES) as arrays:
        return dict(arrays)


def assert_same(some: list[EpisodeSpec], others: list[EpisodeSpec]) -> None:
    for one, other in zip(some, others, strict=True):
        np.testing.assert_equal(vars(one), vars(other))


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Read the file anew, and let others read it anew afterwards."""
    accepted._shipped.cache_clear()
    yield monkeypatch
    monkeypatch.undo()
    accepted._shipped.cache_clear()


@pytest.mark.parametrize("split", STREAMS)
def test_every_seed_has_an_entry_in_a_small_file(split: str):
    assert list(accepted_attempts(Recipe(split=split))) == list(split_seeds(split))
    assert ENTRIES.stat().st_size < 10_000


@pytest.mark.parametrize("split", [*STREAMS, "test_small"])
def test_the_sampler_draws_the_same_as_a_search_from_the_beginning(split: str):
    recipe = Recipe(split=split)
    if split == "twins":
        recipe = changed(recipe, {"path_speed": 1.6, "instructions": "neutral"})
    seeds = split_seeds(split)[STREAMS.index(split) if split in STREAMS else 3 :: 13][:9]
    assert_same(sample_specs(recipe, seeds), searched(recipe, seeds))


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("split", STREAMS)
def test_the_file_says_of_every_seed_what_a_search_finds(split: str):
    found = search(Recipe(split=split), split_seeds(split), threads=0)
    attempts = {candidate.seed: candidate.attempts for candidate, _ in found}
    assert attempts == accepted_attempts(Recipe(split=split))
    assert_same(sample_specs(Recipe(split=split), split_seeds(split)), [spec for _, spec in found])


@pytest.mark.parametrize(
    "change",
    [
        {"salt": "sixteen letters!"},
        {"split": "train"},
        {"motions": ("lob", "planar")},
        {"objects": ("ball", "cube")},
        {"protocol": "direct_act"},
        {"protocol": "occluded"},
        {"capture": "contact"},
        {"hand": "shadow"},
    ],
    ids=str,
)
def test_the_benchmarks_own_episodes_alone_have_entries(change: dict):
    assert accepted_attempts(changed(TEST, change)) == {}


@pytest.mark.parametrize(
    "change",
    [
        {"image_size": 0},
        {"control_class": "late"},
        {"instructions": "neutral"},
        {"views": ("side",)},
    ],
    ids=str,
)
def test_what_has_no_part_in_what_is_accepted_may_differ(change: dict):
    recipe = changed(TEST, change)
    assert len(accepted_attempts(recipe)) == 1000
    assert_same(sample_specs(recipe, range(4)), searched(recipe, range(4)))


@pytest.mark.parametrize("attempt", [1, 33])
def test_an_episode_that_its_attempt_does_not_fit_is_searched_instead(
    attempt: int, fresh, tmp_path: Path
):
    arrays = stored()
    assert arrays["test"][SEARCHED] > attempt
    arrays["test"][SEARCHED] = attempt
    np.savez(tmp_path / "accepted.npz", **arrays)
    fresh.setattr(accepted, "ENTRIES", tmp_path / "accepted.npz")
    assert_same([sample_spec(TEST, SEARCHED)], searched(TEST, [SEARCHED]))


def test_attempts_of_another_benchmark_are_not_read(fresh):
    fresh.setattr(accepted, "BENCHMARK_ID", "v4-00000000")
    assert accepted_attempts(TEST) == {}


def test_a_file_that_differs_is_told_by_the_first_seed(tmp_path: Path):
    arrays = stored()
    arrays["val"][7:9] += 1
    np.savez(tmp_path / "accepted.npz", **arrays)
    (sentence,) = pin.differences(pin.read(), pin.read(entries=tmp_path / "accepted.npz"))
    assert sentence == "2 of 220 attempts of val differ, the first is 7"


def test_attempts_of_another_benchmark_than_the_digests_are_told(tmp_path: Path):
    np.savez(tmp_path / "accepted.npz", **stored() | {"benchmark": "v4-00000000"})
    (sentence,) = pin.differences(pin.read(), pin.read(entries=tmp_path / "accepted.npz"))
    assert sentence == f"attempts are pinned for 'v4-00000000', digests for {BENCHMARK_ID!r}"
