"""``dynahoi pretrain``: train an eye on images of random configurations, as a recipe says."""

import json
import sys
from argparse import ArgumentTypeError
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

import yaml

from dynahoi_lerobot.core.arguments import option
from dynahoi_lerobot.core.features import EYE
from dynahoi_lerobot.core.image_sensor import sensor_training
from dynahoi_lerobot.core.reading import parsed_yaml
from dynahoi_lerobot.core.working_folder import resumable
from dynahoi_lerobot.pretrain.recipe import read_recipe


def setting(text: str) -> tuple[str, Any]:
    """Parse ``KEY=VALUE``, the value as YAML."""
    key, separator, value = text.partition("=")
    try:
        parsed = parsed_yaml(value)
    except (ValueError, yaml.YAMLError):
        separator = ""
    if not separator:
        raise ArgumentTypeError(f"must be KEY=VALUE, the value as YAML, got {text!r}")
    return key, parsed


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi pretrain``."""

    recipe: Path = option(MISSING, "YAML file, such as recipes/eye/ego_96.yaml")
    out: Path | None = option(
        None, "output folder instead of the recipe's; an incomplete run is resumed"
    )
    set: list[tuple[str, Any]] = option(
        list,
        "override a field of the recipe, such as images=100000; may be repeated",
        setting,
        metavar="KEY=VALUE",
    )


def run(options: Options) -> int:
    """Train, print a line at each save, and return the exit code: 1 for a loss that is not
    finite.
    """
    changes = dict(options.set) | ({} if options.out is None else {"out": str(options.out)})
    recipe = read_recipe(options.recipe, **changes)
    training = sensor_training(EYE)(recipe)
    if training.finished:
        print(f"{recipe.out}: already trained on all {recipe.images} images")
    try:
        with resumable():
            for line in training.run():
                print(json.dumps(line), flush=True)
    except FloatingPointError as error:
        print(f"dynahoi pretrain: {error}; the last save is in {recipe.out}", file=sys.stderr)
        return 1
    return 0
