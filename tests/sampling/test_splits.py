"""Splits are disjoint seed streams, and what is held out is never in training."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dynahoi_lerobot.motions import PrescribedMotion
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import split_seeds
from tests.drawing import Drawn, draw_motion

QUICK = ("constant", "lateral", "horizontal_circle", "line_then_arc")
IN_DISTRIBUTION = ("train", "val", "test")
KINDS = BENCHMARK.splits["train"].motions
HELD_OUT_MOTIONS = set(BENCHMARK.splits["ood_motion"].motions)
HELD_OUT_OBJECTS = set(BENCHMARK.splits["ood_object"].objects)
FAST = BENCHMARK.splits["ood_speed"].speed_scale


def test_splits_are_disjoint_streams():
    """No draw of one split recurs in another, whatever the seed."""
    seen: dict[str, str] = {}
    for split in ("train", "val", "test", "ood_speed"):
        for spec in sample_specs(Recipe(split=split, motions=QUICK), range(40)):
            key = spec.motion.parameters()
            assert seen.setdefault(key, split) == split
            assert spec.split == split
    assert len(seen) == 160


def test_a_split_of_the_same_name_is_the_same_stream():
    recipe = Recipe(split="val", motions=QUICK)
    once, again = sample_specs(recipe, range(4)), sample_specs(recipe, range(4))
    assert [s.motion for s in once] == [s.motion for s in again]


@pytest.mark.parametrize("split", BENCHMARK.streams)
def test_only_its_own_split_contains_what_is_held_out(split: str):
    recipe = Recipe(split=split)
    assert HELD_OUT_MOTIONS
    assert HELD_OUT_OBJECTS
    assert bool(HELD_OUT_MOTIONS & set(recipe.motion_names)) == (split == "ood_motion")
    assert bool(HELD_OUT_OBJECTS & set(recipe.object_names)) == (split == "ood_object")
    assert (recipe.speed_scale > 1) == (split == "ood_speed")
    if split in IN_DISTRIBUTION:
        assert recipe.motion_names == list(KINDS)


def test_ood_motion_has_only_held_out_kinds_and_ood_object_only_held_out_objects():
    assert {s.motion.name for s in sample_specs(Recipe(split="ood_motion"), range(6))} == HELD_OUT_MOTIONS
    objects = sample_specs(Recipe(split="ood_object"), range(len(Recipe(split="ood_object").motion_names)))
    assert {s.target.name for s in objects} == HELD_OUT_OBJECTS


@pytest.mark.parametrize("split", IN_DISTRIBUTION)
def test_every_sampled_object_is_one_that_its_motion_and_split_allow(split: str):
    for spec in sample_specs(Recipe(split=split), range(22)):
        assert spec.motion.suits(OBJECTS[spec.target.name])
        assert spec.target.name not in HELD_OUT_OBJECTS


def test_every_kind_can_be_sampled_at_the_speed_of_ood_speed():
    specs = sample_specs(Recipe(split="ood_speed"), range(22))
    assert [spec.motion.name for spec in specs] == list(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_every_draw_of_ood_speed_lies_outside_training(kind: str):
    """Each has some feature that no draw of training has: a speed, a rate, a steepness, a distance thrown."""
    train = _features([draw_motion(kind, seed) for seed in range(200)])
    beyond = _features([draw_motion(kind, seed, speed_scale=FAST) for seed in range(60)])
    outside = [(beyond[name] > train[name].max()) | (beyond[name] < train[name].min()) for name in train]
    assert np.any(outside, axis=0).all(), f"{kind} of ood_speed may be one of train"


@pytest.mark.parametrize("split", BENCHMARK.streams[1:])
def test_evaluation_splits_have_enough_of_every_kind(split: str):
    assert len(split_seeds(split)) >= 10 * len(Recipe(split=split).motion_names)


def _features(drawn: list[Drawn]) -> dict[str, np.ndarray]:
    """Everything that may tell a fast motion from a slow one, (K,) each."""
    rows = [_scalars(one) for one in drawn]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _scalars(drawn: Drawn) -> dict[str, float]:
    """Sizes of the scalar parameters but the angles, which are drawn from a full turn, and what follows from others."""
    values = json.loads(drawn.motion.parameters())
    circular = ("phase_rad", "yaw_rad")
    found = {name: abs(v) for name, v in values.items() if isinstance(v, float) and name not in circular}
    if isinstance(drawn.motion, PrescribedMotion):
        times = np.linspace(0.0, drawn.horizon_s, 200)
        found["peak speed"] = float(np.linalg.norm(drawn.motion.velocity(times), axis=1).max())
    elif "velocity" in values:
        speed = float(np.linalg.norm(values["velocity"][:2]))
        found |= {"level speed": speed, "thrown": speed * (drawn.intercept_s - values["release_s"])}
    return found
