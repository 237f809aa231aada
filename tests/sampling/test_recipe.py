"""Recipes: what is wrong is told in one sentence that names the value and the ones allowed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.recipe import Recipe, load_recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

BAD_VALUES = [
    {"split": "trian"},
    {"protocol": "look"},
    {"instructions": "loud"},
    {"capture": "magnet"},
    {"control_class": "slow"},
    {"motions": ("lateral", "latteral")},
    {"objects": ("bal",)},
    {"appearance": ("fog",)},
    {"views": ("top",)},
    {"views": ("side", "side")},
    {"image_size": 8},
    {"perturbed_share": 1.5},
    {"actor": "somebody"},
    {"motions": ("helix",)},
    {"objects": ("jack",), "split": "test"},
    {"split": "ood_motion", "motions": ("lateral",)},
    {"split": "ood_object", "objects": ("ball",)},
]
BAD_FILES = {
    "an unknown field": ("splt: train\n", "splt"),
    "an unknown name": ("motions: [latteral]\n", "latteral"),
    "a wrong type": ("image_size: large\n", "large"),
    "a text for a list": ("motions: lateral\n", "[lateral]"),
    "null for a list": ("motions: null\n", "motions must not be null"),
    "null in a list": ("motions: [null]\n", "motions must not be null"),
    "null for a number": ("image_size: null\n", "image_size must not be null"),
}


@pytest.mark.parametrize("values", BAD_VALUES, ids=str)
def test_a_bad_value_is_named_in_one_sentence(values: dict):
    *_, value = values.values()
    with pytest.raises(ValueError, match=re.escape(str(value[-1] if isinstance(value, tuple) else value))) as error:
        Recipe(**values)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["hand", "renderer"])
def test_a_batch_refuses_names_it_does_not_know(name: str):
    with pytest.raises(ValueError, match=f"unknown {name} 'x'"):
        WorldBatch(Recipe(**{name: "x"}), 1)


def test_an_unknown_expert_is_refused_before_anything_is_sampled():
    with pytest.raises(ValueError, match=f"unknown expert 'x'; known: {', '.join(EXPERTS.names())}"):
        next(record(Recipe(expert="x"), range(10**6)))


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


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_named_with_what_is_wrong(tmp_path: Path, name: str):
    path, (text, wrong) = tmp_path / "recipe.yaml", BAD_FILES[name]
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(wrong)) as error:
        load_recipe(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match=r"absent\.yaml"):
        load_recipe(tmp_path / "absent.yaml")


def test_the_fingerprint_changes_with_the_recipe():
    assert Recipe().fingerprint() == Recipe().fingerprint()
    assert Recipe().fingerprint() != Recipe(image_size=64).fingerprint()
