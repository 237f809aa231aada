"""The benchmark is a frozen list: its episodes are the committed ones, whatever else is registered."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.motions import CATEGORIES, MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import seed_stream, split_seeds
from tests.third_party import plays

TEST_SMALL_SHA256 = "a9246e287c95cfb1f61b362017a0b97dbe0a42ffcda4bb9b38f9973852c0f4da"
"""Of the 110 specs of ``test_small``, version ``v1-draft``: a new digest is a new version of the benchmark."""
DECIMALS = 6
"""Lengths [m], times [s] and angles [rad] are compared to a millionth, so that compilers may round differently."""
KINDS_PER_CATEGORY = {
    "straight_line": 3,
    "simple_harmonic": 3,
    "circular_arc": 3,
    "projectile": 3,
    "pendulum": 3,
    "inclined_rolling": 2,
    "impact_response": 2,
    "hybrid": 3,
}


def test_it_has_22_kinds_in_8_categories_and_11_objects():
    train = BENCHMARK.splits["train"]
    assert Counter(MOTIONS[name].category for name in train.motions) == KINDS_PER_CATEGORY
    assert set(KINDS_PER_CATEGORY) == set(CATEGORIES)
    assert len(set(train.objects)) == len(train.objects) == 11


@pytest.mark.parametrize("split", BENCHMARK.splits)
def test_everything_it_lists_is_registered(split: str):
    entry = BENCHMARK.splits[split]
    assert set(entry.motions) <= set(MOTIONS.names())
    assert set(entry.objects) <= set(OBJECTS.names())
    assert entry.stream in BENCHMARK.streams


def test_the_specs_of_test_small_are_the_committed_ones():
    specs = sample_specs(Recipe(split=seed_stream("test_small")), split_seeds("test_small"))
    assert spec_digest(specs) == TEST_SMALL_SHA256


def test_what_others_register_changes_no_spec_no_state_and_no_pixel():
    alone = dict(plays.episodes())
    assert len(alone) == plays.EPISODES * (len(BENCHMARK.streams) + 1)
    assert json.loads(run_module("tests.third_party.plays", "--register")) == alone


def test_what_others_register_is_played_by_name(tmp_path: Path):
    run_module("tests.third_party.by_name", str(tmp_path / "dataset"))
    assert (tmp_path / "dataset" / "meta" / "info.json").is_file()


def run_module(*words: str) -> str:
    """Run a module in a process of its own, as what it registers must not reach other tests; return what it prints."""
    done = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


def spec_digest(specs: Sequence[EpisodeSpec]) -> str:
    """Hash of all that a spec holds but the fingerprint of the code."""
    motions = [[spec.motion.name, spec.motion.parameters()] for spec in specs]
    values = [{**vars(spec), "motion": motion, "fingerprint": ""} for spec, motion in zip(specs, motions, strict=True)]
    return hashlib.sha256(json.dumps(_rounded(values), sort_keys=True).encode()).hexdigest()


def _rounded(value):
    if isinstance(value, str):
        return _rounded(json.loads(value)) if value.startswith("{") else value
    if isinstance(value, float | np.floating):
        return round(float(value), DECIMALS) + 0.0  # no negative zero
    if isinstance(value, np.ndarray):
        return _rounded(value.tolist())
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    return _rounded(vars(value)) if hasattr(value, "__dict__") else value
