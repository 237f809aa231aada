"""Splits are disjoint seed streams, what is held out is never in training; salts, and twins at
another speed.
"""

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import CONTROL_DT
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.motions import MOTIONS, PrescribedMotion
from dynahoi_lerobot.report.entries import read_entries
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.homes import visible
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.salt import seal, without_salt
from dynahoi_lerobot.sampling.sampler import sample_spec, sample_specs
from dynahoi_lerobot.sampling.splits import split_seeds
from tests.tools import dynahoi, generated
from tests.world.playing import SMALL, played

QUICK = ("constant", "lateral", "horizontal_circle", "line_then_arc")
IN_DISTRIBUTION = ("train", "val", "test")
KINDS = BENCHMARK.splits["train"].motions
HELD_OUT_MOTIONS = set(BENCHMARK.splits["ood_motion"].motions)
HELD_OUT_OBJECTS = set(BENCHMARK.splits["ood_object"].objects)


def test_splits_are_disjoint_streams():
    """No draw of one split recurs in another, whatever the seed."""
    seen: dict[str, str] = {}
    for split in ("train", "val", "test", "ood_speed"):
        for spec in sample_specs(Recipe(split=split, motions=QUICK), range(20)):
            key = spec.motion.parameters()
            assert seen.setdefault(key, split) == split
            assert spec.split == split
    assert len(seen) == 80


@pytest.mark.parametrize("split", BENCHMARK.streams)
def test_only_its_own_split_contains_what_is_held_out(split: str):
    recipe = Recipe(split=split)
    assert HELD_OUT_MOTIONS
    assert HELD_OUT_OBJECTS
    assert bool(HELD_OUT_MOTIONS & set(recipe.motion_names)) == (split == "ood_motion")
    assert bool(HELD_OUT_OBJECTS & set(recipe.object_names)) == (split == "ood_object")
    assert (recipe.split_definition.speed_scale > 1) == (split == "ood_speed")
    if split in IN_DISTRIBUTION:
        assert recipe.motion_names == list(KINDS)
    if split != "train":
        assert len(split_seeds(split)) >= 10 * len(recipe.motion_names), (
            "an evaluation has enough of every kind"
        )


SALT = "correct horse battery staple"
OTHER = "correct horse battery stable"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results of three episodes of the public stream, of a salt and of another one."""
    root = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        for name, salt in (("public", ""), ("salted", SALT), ("other", OTHER)):
            words = ["--salt", salt] if salt else []
            patch.setattr("sys.argv", ["dynahoi", "evaluate", *words])
            dynahoi("evaluate", "--policy", "hold", "--episodes", "3", "--out", root / name, *words)
    shutil.copytree(root / "salted", root / "again")
    return {folder.name: folder for folder in root.iterdir()}


def test_another_salt_is_another_episode_and_the_same_salt_the_same():
    public, salted, other = (
        sample_spec(replace(SMALL, salt=salt), 3) for salt in ("", SALT, OTHER)
    )
    assert public.motion.name == salted.motion.name == other.motion.name, "kinds still take turns"
    homes = np.stack([spec.home_pos_w for spec in (public, salted, other)])
    assert len(np.unique(homes, axis=0)) == 3
    np.testing.assert_array_equal(
        sample_spec(replace(SMALL, salt=SALT), 3).target_path_w, salted.target_path_w
    )
    assert public.split == "test"
    assert salted.split == f"test+{seal(SALT).removeprefix('sha256:')[:8]}"
    assert len({public.split, salted.split, other.split}) == 3


def test_no_file_of_a_result_or_a_dataset_holds_the_salt(runs: dict[str, Path], tmp_path: Path):
    root = generated(tmp_path / "dataset", "--image-size", "0", "--salt", SALT)
    dynahoi("verify", root)
    files = [
        path for folder in (root, *runs.values()) for path in folder.rglob("*") if path.is_file()
    ]
    assert not [path for path in files if SALT.encode() in path.read_bytes()]
    head = json.loads((runs["salted"] / "metrics.json").read_text())
    assert "(hidden)" in head["command"]
    provenance = json.loads((root / MANIFEST_PATH).read_text())["provenance"]
    assert head["recipe"]["salt"] == provenance["recording"]["recipe"]["salt"] == seal(SALT)


def test_a_hash_makes_no_episode():
    """Also not by being taken for a salt."""
    with pytest.raises(ValueError, match="salt"):
        sample_spec(replace(SMALL, salt=seal(SALT)), 0)


def test_results_of_one_salt_are_compared_and_others_are_refused_by_name(runs: dict[str, Path]):
    assert len(read_entries([runs["salted"], runs["again"]])) == 2
    for name in ("public", "other"):
        with pytest.raises(ValueError, match=f"salted has salt .*{name} has salt"):
            read_entries([runs["salted"], runs[name]])


def test_a_salt_that_can_be_guessed_is_refused_and_not_repeated():
    with pytest.raises(ValueError, match="at least 16 characters") as refused:
        Recipe(salt="hush!")
    assert "hush!" not in str(refused.value)


@pytest.mark.parametrize(
    ("words", "kept"),
    [
        (
            ["evaluate", "--salt", SALT, "--gifs", "1"],
            ["evaluate", "--salt", "(hidden)", "--gifs", "1"],
        ),
        ([f"--salt={SALT}", "--gifs=1"], ["--salt=(hidden)", "--gifs=1"]),
        (["--env.salt", SALT], ["--env.salt", "(hidden)"]),
        ([f"--env.salt={SALT}"], ["--env.salt=(hidden)"]),
    ],
)
def test_recorded_command_lines_hide_it(words: list[str], kept: list[str]):
    assert without_salt(words) == kept


SLOW, FAST = (Recipe(split="twins", path_speed=speed) for speed in (1.0, 1.6))
N_KINDS = len(SLOW.motion_names)
DIFFERENT = {"motion", "target_path_w", "code"}


@pytest.fixture(scope="module")
def pairs() -> list[tuple[EpisodeSpec, EpisodeSpec]]:
    """Every kind twice, at both speeds."""
    return list(
        zip(*(sample_specs(recipe, range(2 * N_KINDS)) for recipe in (SLOW, FAST)), strict=True)
    )


def test_every_kind_whose_path_is_prescribed_has_twins():
    prescribed = {
        name
        for name in BENCHMARK.splits["train"].motions
        if issubclass(MOTIONS[name], PrescribedMotion)
    }
    assert set(SLOW.motion_names) == prescribed
    assert BENCHMARK.splits["twins"].size % N_KINDS == 0


def test_nothing_but_the_speed_differs_on_a_path_that_leads_to_the_intercept_in_the_same_frame(
    pairs,
):
    for slow, fast in pairs:
        for field in fields(EpisodeSpec):
            if field.name not in DIFFERENT:
                np.testing.assert_equal(
                    getattr(slow, field.name), getattr(fast, field.name), field.name
                )
        assert (slow.motion.name, slow.motion.phrase) == (fast.motion.name, fast.motion.phrase)
        later_s = np.linspace(-0.3, 0.3, 7)
        meeting_s = slow.intercept_frame * CONTROL_DT
        np.testing.assert_allclose(
            fast.motion.position(meeting_s + later_s),
            slow.motion.position(meeting_s + 1.6 * later_s),
            atol=1e-9,
        )
        for spec in (slow, fast):
            assert (
                np.linalg.norm(spec.target_path_w[spec.intercept_frame] - slow.intercept_pos_w)
                < 1e-9
            )


def test_both_can_be_watched_and_met_alike(pairs: list[tuple[EpisodeSpec, EpisodeSpec]]):
    for spec in (spec for pair in pairs for spec in pair):
        seen = visible(spec.target_path_w[: spec.window_frames + 1] - spec.home_pos_w)
        assert seen.mean() >= 0.9
    episodes = played(FAST.rules, EXPERTS["intercept"](), [fast for _, fast in pairs])
    assert np.mean([episode.success for episode in episodes]) > 0.9
    assert {episode.meta.split for episode in episodes} == {"twins"}


def test_twins_are_not_recorded():
    with pytest.raises(ValueError, match="is for evaluations"):
        Recording(SLOW)
