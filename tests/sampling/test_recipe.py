"""Recipes: what is wrong is told in one sentence that names the value and the ones allowed."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.recipe import Recipe, load_recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

BAD_VALUES = [
    ({"split": "trian"}, "unknown split 'trian'; known: train, val, test"),
    (
        {"protocol": "look"},
        "unknown protocol 'look'; known: observe_before_act, direct_act, observe_then_blind, occluded",
    ),
    ({"instructions": "loud"}, "unknown instructions 'loud'; known: reveal, neutral, mixed"),
    ({"motions": ("lateral", "latteral")}, r"unknown motion 'latteral' \(did you mean 'lateral'\?\); known: acc"),
    ({"objects": ("bal",)}, r"unknown object 'bal' \(did you mean 'ball'\?\); known: ball, block"),
    ({"image_size": 8}, "image_size must be 16 to 1024 pixels, or 0 for no camera, got 8"),
    ({"hold_frames": 3}, "hold_frames must be at least 12, or null, got 3"),
    ({"disturbance_m": 0.5}, "disturbance_m must be 0 to 0.2 m, got 0.5"),
    ({"motions": ("helix",)}, "motion 'helix' is held out for split 'ood_motion', got split 'train'"),
    ({"objects": ("jack",), "split": "test"}, "object 'jack' is held out for split 'ood_object', got split 'test'"),
    (
        {"motions": ("lateral",), "split": "ood_motion"},
        "'ood_motion' holds only held-out motions, got motion 'lateral'",
    ),
    ({"objects": ("ball",), "split": "ood_object"}, "'ood_object' holds only held-out objects, got object 'ball'"),
]
BAD_FILES = [
    ("splt: train\n", "The fields `splt` are not valid for Recipe"),
    ("split: trian\n", "unknown split 'trian'; known: train"),
    ("image_size: large\n", "`image_size`: Couldn't parse 'large' into an int"),
    ("motions: [latteral]\n", "unknown motion 'latteral'"),
    ("- split\n", "must map keys to values, got a list"),
    ("motions: [\n", "is not YAML: while parsing"),
]


@pytest.mark.parametrize(("values", "message"), BAD_VALUES)
def test_a_bad_value_is_named_with_those_allowed(values: dict, message: str):
    with pytest.raises(ValueError, match=message) as error:
        Recipe(**values)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("capture", "unknown capture rule 'x'; known: attach"),
        ("hand", "unknown hand 'x'; known: capsule"),
        ("renderer", "unknown renderer 'x'; known: "),
    ],
)
def test_a_batch_refuses_names_it_does_not_know(name: str, message: str):
    with pytest.raises(ValueError, match=message):
        WorldBatch(Recipe(**{name: "x"}), 1)


def test_an_unknown_expert_is_refused_before_anything_is_sampled():
    with pytest.raises(ValueError, match=f"unknown expert 'x'; known: {', '.join(EXPERTS.names())}"):
        next(record(Recipe(expert="x"), range(10**6)))


@pytest.mark.parametrize("size", [0, -3])
def test_a_batch_needs_a_world(size: int):
    with pytest.raises(ValueError, match=f"a batch needs at least 1 world, got {size}"):
        WorldBatch(Recipe(), size)


def test_a_negative_seed_is_refused():
    with pytest.raises(ValueError, match="a seed must be 0 to 9223372036854775807, got -1"):
        sample_specs(Recipe(), [0, -1])


def test_a_motion_without_a_fitting_object_is_refused():
    with pytest.raises(ValueError, match="motion 'ramp' takes none of the objects egg, ring"):
        sample_specs(Recipe(motions=("ramp",), objects=("egg", "ring")), [0])


def test_kinds_that_no_object_of_the_recipe_can_perform_are_left_out():
    names = Recipe(objects=("egg",)).motion_names
    assert "constant" in names
    assert not {"ramp", "bounce", "struck"} & set(names)


def test_a_recipe_file_gives_the_recipe(tmp_path: Path):
    path = tmp_path / "recipe.yaml"
    path.write_text("split: val\nmotions: [lateral, ramp]\nimage_size: 64\n")
    assert load_recipe(path) == Recipe(split="val", motions=("lateral", "ramp"), image_size=64)
    path.write_text("# everything as usual\n")
    assert load_recipe(path) == Recipe()


@pytest.mark.parametrize(("text", "message"), BAD_FILES)
def test_a_bad_file_is_named_with_what_is_wrong(tmp_path: Path, text: str, message: str):
    path = tmp_path / "recipe.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        load_recipe(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path: Path):
    with pytest.raises(ValueError, match=r"there is no recipe at .*absent\.yaml"):
        load_recipe(tmp_path / "absent.yaml")


def test_the_fingerprint_changes_with_the_recipe():
    assert Recipe().fingerprint() == Recipe().fingerprint()
    assert Recipe().fingerprint() != Recipe(image_size=64).fingerprint()
