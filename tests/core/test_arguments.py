"""Options derived from a dataclass: names, types and help come from it, and nothing is given unless it is said."""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import fields

import pytest

from dynahoi_lerobot.core.arguments import add_field_arguments, field_docs, given_fields
from dynahoi_lerobot.sampling.recipe import Recipe

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


def test_a_wrong_type_is_refused(parser: ArgumentParser):
    with pytest.raises(SystemExit):
        parser.parse_args(["--image-size", "large"])
