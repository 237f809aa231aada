"""The benchmark is a frozen list: its episodes have the committed digests, whatever else is
registered.
"""

import os
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from benchmarks import pin
from dynahoi_lerobot.sampling.benchmark import BENCHMARK, EPISODES_DIGEST
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import search
from dynahoi_lerobot.sampling.splits import split_seeds
from tests.tools import python

PINNED = pin.read()
ROOT = Path(__file__).parents[2]


def test_the_definition_is_pinned():
    assert (pin.definition(), BENCHMARK.version) == (PINNED["definition"], PINNED["version"]), (
        "a change of the definition is a new version of the benchmark"
    )
    assert pin.digest_of(PINNED) == EPISODES_DIGEST, "by which results tell what they may compare"


def test_the_definition_holds_all_that_decides_a_result(monkeypatch: pytest.MonkeyPatch):
    said = asdict(BENCHMARK)
    classes = [control["name"] for control in said["rules"]["control_classes"]]
    assert classes == ["unlimited", "standard", "late"], "a further class does not enter it"
    faster = tuple(
        replace(control, palm_speed_m_s=0.6) for control in BENCHMARK.rules["control_classes"]
    )
    for change in (
        {"look": BENCHMARK.look + 1},
        {"rules": BENCHMARK.rules | {"control_classes": faster}},
        {"rules": BENCHMARK.rules | {"min_window_frames": 9}},
        {"splits": {**BENCHMARK.splits, "val": replace(BENCHMARK.splits["val"], size=221)}},
        {"durations": replace(BENCHMARK.durations, shares=(0.2, 0.3, 0.2, 0.2, 0.1))},
    ):
        monkeypatch.setattr(pin, "BENCHMARK", replace(BENCHMARK, **change))
        assert pin.definition() != PINNED["definition"], change


def test_every_seed_of_all_streams_is_pinned():
    assert {split: len(digests) for split, digests in PINNED["specs"].items()} == {
        split: len(pin.pinned_seeds(split)) for split in BENCHMARK.streams
    }
    assert len(PINNED["specs"]["test"]) == len(split_seeds("test")) == 1000


@pytest.mark.slow
@pytest.mark.parametrize("split", BENCHMARK.streams)
def test_specs_are_the_pinned_ones(split: str):
    """Some, of all kinds of motion; ``benchmarks/pin.py --check`` compares all."""
    seeds = pin.pinned_seeds(split)
    some = seeds[BENCHMARK.streams.index(split) :: 43 if len(seeds) == 1000 else 9]
    found = {spec.seed: pin.spec_digest(spec) for _, spec in search(Recipe(split=split), some)}
    assert found == {seed: PINNED["specs"][split][seed] for seed in found}
    assert len(found) > 22


@pytest.mark.parametrize("split", BENCHMARK.streams)
def test_images_are_the_pinned_ones(split: str):
    found = pin.image_digests(split)
    assert found == {
        name: digest for name, digest in PINNED["images"].items() if name.startswith(f"{split}/")
    }
    assert len(found) == pin.IMAGE_EPISODES


@pytest.mark.slow
def test_what_others_register_is_played_by_name_and_changes_no_digest(tmp_path: Path):
    folder = tmp_path / "dataset"
    # in a process of its own: its entries in registries must not reach other tests
    path = os.pathsep.join(
        str(ROOT / name) for name in ("benchmarks", "tests/third_party/lerobot_policy_forward")
    )
    python("-m", "tests.third_party.by_name", folder, cwd=ROOT, PYTHONPATH=path)
    assert (folder / "meta" / "info.json").is_file()
