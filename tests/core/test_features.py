"""One feature table for spaces, recordings and datasets; options derived from a dataclass."""

from argparse import ArgumentParser
from dataclasses import fields
from math import prod

import pytest

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.arguments import add_field_arguments, field_docs, given_fields
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import FEATURES
from dynahoi_lerobot.sampling.recipe import Recipe


def test_every_array_of_an_episode_is_in_the_table_and_nothing_else() -> None:
    arrays = {field.name for field in fields(Episode) if "ndarray" in str(field.type) or field.type is float}
    assert arrays == {name for name, feature in FEATURES.items() if not feature.derived} | {"images"}
    assert all(isinstance(getattr(Episode, name), property) for name, f in FEATURES.items() if f.derived)


def test_observations_hold_what_policies_may_see() -> None:
    observed = {feature.name for feature in FEATURES.values() if feature.observed}
    assert {field.name for field in fields(Observation)} == {*observed, "images", "tasks"}


def test_no_privileged_feature_is_called_an_observation() -> None:
    for feature in FEATURES.values():
        assert (feature.gym_key is None) == (not feature.observed and feature.name != "action"), feature.name


def test_elements_are_named_and_keys_are_unique() -> None:
    assert all(len(feature.names) == prod(feature.column_shape) for feature in FEATURES.values())
    told_apart = {(feature.key, feature.shape) for feature in FEATURES.values()}
    assert len(told_apart) == len(FEATURES)
    assert len({feature.key for feature in FEATURES.values()}) == len(FEATURES) - 1, "two kinds of environment_state"


NAMES = tuple(entry.name for entry in fields(Recipe))


@pytest.fixture
def parser() -> ArgumentParser:
    made = ArgumentParser()
    add_field_arguments(made, Recipe, NAMES, protocol="more of it")
    return made


def test_every_field_of_a_recipe_is_documented_and_an_option(parser: ArgumentParser):
    assert tuple(field_docs(Recipe)) == NAMES
    for name, text in field_docs(Recipe).items():
        assert f"--{name.replace('_', '-')}" in parser.format_help()
        assert text


def test_only_what_is_said_is_given_and_has_the_type_of_its_field(parser: ArgumentParser):
    assert given_fields(parser.parse_args([]), NAMES) == {}
    words = ["--motions=lob,ramp", "--image-size=0", "--perturbed-share=0.1", "--keep-failures"]
    given = given_fields(parser.parse_args([*words, "--capture", "contact"]), NAMES)
    assert given == {
        "motions": ("lob", "ramp"), "image_size": 0, "perturbed_share": 0.1, "keep_failures": True,
        "capture": "contact",
    }  # fmt: skip
    recipe = Recipe().changed(**given)
    assert (recipe.hand, recipe.expert) == ("opposed", "match"), "they come with the capture rule"
    assert Recipe(capture="contact").changed(image_size=32).hand == "opposed"
