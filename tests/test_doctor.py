"""``dynahoi doctor``: it finds what is wrong with a machine, and whether episodes are ours bit for
bit.
"""

import json
import shutil
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dynahoi_lerobot import doctor
from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.doctor import TOLERANCE, Fact, Reference, compare, play


def by_name(facts) -> dict[str, Fact]:
    return {fact.name: fact for fact in facts}


@pytest.fixture(scope="module")
def ours() -> Reference:
    return doctor.read_reference()


def test_this_machine_has_no_problems(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(doctor, "PACED_EPISODES", 2)
    facts = list(doctor.examine(tmp_path))
    assert {fact.name for fact in facts if fact.problem} <= {"torchcodec"}
    assert {"cores", "disk", "GPU", "PyAV", "Python", "pace"} <= {fact.name for fact in facts}


def test_the_command_writes_every_fact_and_fails_with_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    good = Fact("cores", "2", "two workers")
    bad = Fact("torch", "0.1", "needs 2", problem=True)
    for found, code in (([good], 0), ([good, bad], 1)):
        monkeypatch.setattr(doctor, "examine", lambda folder, found=found: iter(found))
        assert main(["doctor", "--json", str(tmp_path / "facts.json")]) == code
        assert [Fact(**fact) for fact in json.loads((tmp_path / "facts.json").read_text())] == found


def test_a_part_that_breaks_is_a_problem_and_the_others_are_looked_at(
    monkeypatch: pytest.MonkeyPatch,
):
    def broken():
        yield from ()
        raise OSError("no such device")

    monkeypatch.setattr(doctor, "gpu", broken)
    for part in ("codecs", "pace"):
        monkeypatch.setattr(doctor, part, lambda: iter(()))
    facts = doctor.examine(Path())
    found = Fact("gpu", "check failed: OSError: no such device", problem=True)
    assert [fact for fact in facts if fact.problem] == [found]


def test_a_full_disk_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda place: SimpleNamespace(free=10**8))
    (fact,) = doctor.disk(tmp_path / "not" / "there")
    assert fact.problem
    assert str(tmp_path) in fact.found


@pytest.mark.parametrize("missing", [True, False])
def test_missing_libraries_of_ffmpeg_are_a_problem(missing: bool, monkeypatch) -> None:
    def load(name: str) -> None:
        if missing:
            raise RuntimeError("Could not load libtorchcodec")

    monkeypatch.setattr(doctor.importlib, "import_module", load)
    fact = by_name(doctor.codecs())["torchcodec"]
    assert fact.problem == missing
    assert ("FFmpeg" in fact.follows) == missing


def test_versions_out_of_bounds_and_absent_libraries_are_problems(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        doctor, "requires", lambda name: ["numpy>=99", "tqdm>=4", "nowhere", "other; extra == 'x'"]
    )
    assert {fact.name for fact in doctor.versions() if fact.problem} == {"numpy", "nowhere"}


def test_a_plugin_that_cannot_be_imported_is_a_problem(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        doctor,
        "entry_points",
        lambda group: [EntryPoint("spiral", "no_such_package", doctor.GROUP)],
    )
    fact = by_name(doctor.plugins())["plugin spiral"]
    assert fact.problem
    assert "no_such_package" in fact.follows


@pytest.mark.parametrize(
    ("cores", "share", "minutes"), [(1, 1.0, 9), (2, 1.0, 6), (16, 1.0, 6), (2, 0.5, 11)]
)
def test_the_quickstart_takes_as_long_as_where_it_was_timed_by_pace(
    monkeypatch, cores, share, minutes
):
    monkeypatch.setattr(doctor, "frames_per_s", lambda: share * doctor.KNOWN_FRAMES_S)
    monkeypatch.setattr(doctor, "cores", lambda: cores)
    (fact,) = doctor.pace()
    assert f"{minutes} min" in fact.follows


@pytest.mark.slow
def test_this_machine_moves_as_the_reference_does(ours: Reference):
    first = {
        name: ours[name][:22] if name in ("motions", "images", "pixels") else ours[name]
        for name in ours
    }
    facts = by_name(compare(play(22), first))
    assert not [fact for fact in facts.values() if fact.problem], facts
    assert facts["motion"].found.startswith("22 of 22 episodes"), (
        "bit for bit on x86_64, on which it was made"
    )
    assert facts["images"].found.startswith("22 of 22 episodes")


@pytest.mark.parametrize(("off", "problem"), [(TOLERANCE / 2, False), (0.01, True)])
def test_a_small_difference_is_measured_and_a_large_one_is_a_problem(
    ours: Reference, off: float, problem: bool
):
    poses = ours["poses"].copy()
    poses[5, 18] += off
    found = ours | {"motions": np.array(["f" * 16, *ours["motions"][1:]]), "poses": poses}
    fact = by_name(compare(found, ours))["motion"]
    assert fact.problem == problem
    assert fact.found.startswith("43 of 44 episodes")


def test_other_lengths_are_a_problem_and_other_pixels_are_counted(ours: Reference):
    pixels = ours["pixels"].copy()
    pixels[3, 0, 0, 0] ^= 1
    images = np.array(["f" * 16, *ours["images"][1:]])
    found = ours | {
        "motions": ours["motions"][::-1],
        "poses": ours["poses"][1:],
        "images": images,
        "pixels": pixels,
    }
    facts = by_name(compare(found, ours))
    assert facts["motion"].problem
    assert not facts["images"].problem
    assert "at most 1 of 255" in facts["images"].found
