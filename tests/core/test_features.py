"""One feature table for spaces, recordings and datasets; options derived from a dataclass."""

from argparse import ArgumentError, ArgumentParser
from dataclasses import MISSING, dataclass, fields
from math import prod
from pathlib import Path
from typing import Any

import pytest

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.arguments import (
    add_options,
    argument,
    given_of,
    option,
    read_options,
    whole,
)
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import FEATURES
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe


def test_every_array_of_an_episode_is_in_the_table_and_nothing_else() -> None:
    arrays = {
        field.name
        for field in fields(Episode)
        if "ndarray" in str(field.type) or field.type is float
    }
    assert arrays == {name for name, feature in FEATURES.items() if not feature.derived} | {
        "images"
    }
    assert all(
        isinstance(getattr(Episode, name), property) for name, f in FEATURES.items() if f.derived
    )


def test_observations_hold_what_policies_may_see_and_nothing_else_is_called_one() -> None:
    observed = {feature.name for feature in FEATURES.values() if feature.observed}
    assert {field.name for field in fields(Observation)} == {*observed, "images", "tasks"}
    for feature in FEATURES.values():
        assert (feature.gym_key is None) == (not feature.observed and feature.name != "action"), (
            feature.name
        )


def test_elements_are_named_and_keys_are_unique() -> None:
    assert all(len(feature.names) == prod(feature.column_shape) for feature in FEATURES.values())
    assert len({(feature.key, feature.shape) for feature in FEATURES.values()}) == len(FEATURES)


@dataclass(frozen=True, kw_only=True)
class Options:
    root: Path = argument("a folder")
    seed: int = option(MISSING, "a number")
    size: int | None = option(None, "half of 100 %", whole(1, 9))
    dry_run: bool = option(False, "a switch")
    sets: list[str] = option(list, "may be repeated")
    given: dict[str, Any] = given_of(Recording, {Rules: "more of it"})


def read(*words: str) -> Options:
    parser = ArgumentParser(exit_on_error=False)
    add_options(parser, Options)
    return read_options(Options, vars(parser.parse_args(["/made", "--seed=7", *words])))


def test_a_command_line_becomes_a_dataclass_with_its_defaults() -> None:
    assert read() == Options(root=Path("/made"), seed=7)
    given = read("--dry-run", "--sets=a", "--sets", "b", "--size", "3")
    assert given == Options(root=Path("/made"), seed=7, size=3, dry_run=True, sets=["a", "b"])
    with pytest.raises(ArgumentError, match="10"):
        read("--size", "10")


def test_every_option_is_helped() -> None:
    parser = ArgumentParser()
    add_options(parser, Options)
    told = " ".join(parser.format_help().split())
    assert "half of 100 %" in told
    for entry in (*fields(Recording), *fields(Recipe), *fields(Rules)):
        if "help" in entry.metadata:
            assert f"--{entry.name.replace('_', '-')}" in told
            assert entry.metadata["help"] in told
    assert told.count("more of it") == len(fields(Rules))


def test_only_what_is_said_of_a_recipe_is_given_and_has_the_type_of_its_field():
    given = read(
        "--motions=lob,ramp",
        "--image-size=0",
        "--perturbed-share=0.1",
        "--keep-failures",
        "--capture=contact",
    )
    assert given.given == {
        "motions": ("lob", "ramp"), "image_size": 0, "perturbed_share": 0.1, "keep_failures": True,
        "capture": "contact",
    }  # fmt: skip
    recording = Recording.of(**given.given)
    assert recording.expert_name == "match", "it comes with the capture rule"
    assert recording.recipe.rules.hand_name == "opposed"
