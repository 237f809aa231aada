"""The benchmark is a frozen list: its episodes are the committed ones, whatever else is registered."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from dynahoi_lerobot.motions import CATEGORIES, MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from tests.third_party import plays

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


@pytest.mark.slow
def test_what_others_register_changes_no_spec_no_state_and_no_pixel():
    alone = dict(plays.episodes())
    assert len(alone) == plays.EPISODES * (len(BENCHMARK.streams) + 1)
    assert json.loads(run_module("tests.third_party.plays", "--register")) == alone


@pytest.mark.slow
def test_what_others_register_is_played_by_name(tmp_path: Path):
    run_module("tests.third_party.by_name", str(tmp_path / "dataset"))
    assert (tmp_path / "dataset" / "meta" / "info.json").is_file()


def run_module(*words: str) -> str:
    """Run a module in a process of its own, as what it registers must not reach other tests; return what it prints."""
    done = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]
