"""The reference tells bit-for-bit agreement, and by how much a machine is off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.doctor import command, reference
from dynahoi_lerobot.doctor.parts import Fact
from dynahoi_lerobot.doctor.reference import EPISODES, REFERENCE, TOLERANCE, Reference, compare, play


@pytest.fixture(scope="module")
def ours() -> Reference:
    return Reference.read()


def told(found: Reference, wanted: Reference) -> dict[str, Fact]:
    return {fact.name: fact for fact in compare(found, wanted)}


def test_the_file_is_small_and_holds_every_kind_twice(ours: Reference):
    assert REFERENCE.stat().st_size < 100_000
    assert len(set(ours.motions)) == len(set(ours.pictures)) == len(ours.images) == EPISODES == 44
    assert "mujoco 4." in ours.machine


@pytest.mark.slow
def test_this_machine_moves_as_the_reference_does(ours: Reference):
    facts = told(play(), ours)
    assert not [fact for fact in facts.values() if fact.problem], facts
    assert facts["motion"].found.startswith("44 of 44 episodes"), "bit for bit on x86_64, on which it was made"
    assert facts["images"].found.startswith("44 of 44 episodes")


def test_the_same_episodes_in_other_numbers_are_the_same():
    few = play(2)
    assert told(few, few)["motion"].found == "2 of 2 episodes are bit-identical to ours"
    wanted = Reference.read()
    assert few.motions.tolist() == wanted.motions[:2].tolist()
    np.testing.assert_array_equal(few.images, wanted.images[:2])


def test_a_small_difference_is_measured_and_a_large_one_is_a_problem(ours: Reference):
    others = np.array(["f" * 16, *ours.motions[1:]])
    for off, problem in ((TOLERANCE / 2, False), (0.01, True)):
        poses = ours.poses.copy()
        poses[5, 18] += off
        fact = told(replace(ours, motions=others, poses=poses), ours)["motion"]
        assert fact.problem == problem
        assert fact.found.startswith("43 of 44 episodes")
        assert f"{off:.1g}" in fact.found or f"{off:.2g}" in fact.found


def test_other_lengths_are_a_problem(ours: Reference):
    shorter = replace(ours, motions=ours.motions[::-1], poses=ours.poses[1:])
    fact = told(shorter, ours)["motion"]
    assert fact.problem


def test_pixels_that_differ_are_counted_in_levels_and_are_no_problem(ours: Reference):
    images = ours.images.copy()
    images[3, 0, 0, 0] ^= 1
    fact = told(replace(ours, images=images, pictures=np.array(["f" * 16, *ours.pictures[1:]])), ours)["images"]
    assert not fact.problem
    assert "43 of 44" in fact.found
    assert "pixels off by at most 1 of 255" in fact.found


def test_the_command_compares_if_it_is_asked(
    ours: Reference, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(command, "examine", lambda folder: iter(()))
    monkeypatch.setattr(
        reference, "play", lambda count: replace(ours, motions=ours.motions[::-1], poses=ours.poses + 1)
    )
    assert main(["doctor"]) == 0
    assert "reference" not in capsys.readouterr().out
    assert main(["doctor", "--reference"]) == 1
    said = capsys.readouterr().out
    assert "PROBLEM: 0 of 44 episodes" in said
    assert said.endswith("problems: motion\n")
