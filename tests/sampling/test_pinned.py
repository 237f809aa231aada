"""The benchmark is the one that its version promises: definition, specs and pictures have the committed digests."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from benchmarks import pin
from dynahoi_lerobot.core.rules import CONTROL_CLASSES
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.splits import split_seeds

PINNED = pin.read()
ROOT = Path(__file__).parents[2]
PLUGIN = """
from tests.third_party import register
register()
"""
WITH_PLUGIN = """
import json
from benchmarks import pin
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.objects import OBJECTS
assert "a_drift" in MOTIONS and "caltrop" in OBJECTS, "the plugin is not loaded"
print(json.dumps(pin.pin(seeds=3, pictured=2)))
"""


def sample(split: str) -> range:
    """Eleven seeds over the whole split, of different kinds of motion."""
    seeds = pin.pinned_seeds(split)
    return seeds[BENCHMARK.streams.index(split) :: len(seeds) // 11]


def test_the_definition_is_pinned():
    assert (pin.definition(), BENCHMARK.version) == (PINNED["definition"], PINNED["version"]), (
        "a change of the definition is a new version of the benchmark"
    )


def test_the_definition_holds_all_that_decides_a_result(monkeypatch: pytest.MonkeyPatch):
    said = asdict(BENCHMARK)
    assert [control["name"] for control in said["rules"]["control_classes"]] == list(CONTROL_CLASSES)
    faster = tuple(replace(control, palm_speed_m_s=0.6) for control in BENCHMARK.rules.control_classes)
    for change in (
        {"look": BENCHMARK.look + 1},
        {"rules": replace(BENCHMARK.rules, control_classes=faster)},
        {"rules": replace(BENCHMARK.rules, min_window_frames=9)},
        {"splits": {**BENCHMARK.splits, "val": replace(BENCHMARK.splits["val"], size=221)}},
        {"durations": replace(BENCHMARK.durations, shares=(0.2, 0.3, 0.2, 0.2, 0.1))},
    ):
        monkeypatch.setattr(pin, "BENCHMARK", replace(BENCHMARK, **change))
        assert pin.definition() != PINNED["definition"], change


def test_every_seed_of_all_six_splits_is_pinned():
    assert {split: len(digests) for split, digests in PINNED["specs"].items()} == {
        split: len(pin.pinned_seeds(split)) for split in BENCHMARK.streams
    }
    assert len(BENCHMARK.streams) == 6
    assert len(PINNED["specs"]["test"]) == len(split_seeds("test")) == 1000


@pytest.mark.parametrize("split", BENCHMARK.streams)
def test_a_sample_of_specs_is_the_pinned_one(split: str):
    compare(split, pin.spec_digests(split, sample(split)))


@pytest.mark.slow
@pytest.mark.parametrize("split", BENCHMARK.streams)
def test_all_specs_are_the_pinned_ones(split: str):
    compare(split, pin.spec_digests(split, pin.pinned_seeds(split)))


def compare(split: str, found: Mapping[int, str]) -> None:
    wanted = PINNED["specs"][split]
    assert found == {seed: wanted[seed] for seed in found}


@pytest.mark.parametrize("split", BENCHMARK.streams)
def test_pictures_are_the_pinned_ones(split: str):
    found = pin.picture_digests(split)
    assert found == {name: digest for name, digest in PINNED["pictures"].items() if name.startswith(f"{split}/")}
    assert len(found) == pin.PICTURED_EPISODES


@pytest.mark.parametrize(("batch_size", "threads"), [(1, 1), (3, 2)])
def test_batch_size_and_threads_change_no_digest(batch_size: int, threads: int):
    found = pin.picture_digests("test", batch_size=batch_size, threads=threads)
    assert found == {name: PINNED["pictures"][name] for name in found}
    seeds = [4, 900, 17]
    assert pin.spec_digests("test", seeds, threads=threads) == {seed: PINNED["specs"]["test"][seed] for seed in seeds}


@pytest.mark.slow
def test_a_motion_and_an_object_of_a_plugin_change_no_digest(tmp_path: Path):
    info = tmp_path / "third_party-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third_party\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[dynahoi_lerobot.plugins]\nours = third_party_plugin\n")
    (tmp_path / "third_party_plugin.py").write_text(PLUGIN)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (tmp_path, ROOT, ROOT / "benchmarks")))}
    done = subprocess.run(
        [sys.executable, "-c", WITH_PLUGIN], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    found["specs"] = {split: {int(seed): digest for seed, digest in d.items()} for split, d in found["specs"].items()}
    assert sum(map(len, found["specs"].values())) == 18
    assert len(found["pictures"]) == 12
    assert pin.differences(found, PINNED) == []


def test_what_differs_is_named():
    specs = {"val": {0: PINNED["specs"]["val"][0], 7: "0" * 8}}
    found = PINNED | {"version": "v0", "specs": specs, "pictures": {"val/4": "0" * 16}}
    assert pin.differences(found, PINNED) == [
        f"version is 'v0'; pinned is '{BENCHMARK.version}'",
        "1 of 2 specs of val differ, the first is 7",
        "1 of 1 pictures differ, the first is val/4",
    ]
