"""``dynahoi pretrain``: train an eye on images of random configurations, as a recipe says."""

import argparse
import json
import sys
from typing import Any

import yaml

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.core.reading import parsed_yaml
from dynahoi_lerobot.pretrain.recipe import read_recipe
from dynahoi_lerobot.pretrain.snapshots import ImageStream


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi pretrain``."""
    parser.add_argument("--recipe", type=path, required=True, help="YAML file, such as recipes/eye/ego_96.yaml")
    parser.add_argument("--out", type=path, help="output folder instead of the recipe's; an incomplete run is resumed")
    parser.add_argument(
        "--set",
        type=setting,
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a field of the recipe, such as images=100000; may be repeated",
    )


def setting(text: str) -> tuple[str, Any]:
    """Parse ``KEY=VALUE``, the value as YAML."""
    key, separator, value = text.partition("=")
    try:
        parsed = parsed_yaml(value)
    except (ValueError, yaml.YAMLError):
        separator = ""
    if not separator:
        raise argparse.ArgumentTypeError(f"must be KEY=VALUE, the value as YAML, got {text!r}")
    return key, parsed


def run(args: argparse.Namespace) -> int:
    """Train, print a line at each save, and return the exit code: 1 without ObAct or for a loss that is not finite."""
    try:
        from dynahoi_lerobot.pretrain.eye_training import Training
    except ImportError as error:
        print(f"dynahoi pretrain: needs ObAct ({error}): install lerobot_policy_obact", file=sys.stderr)
        return 1
    changes = dict(args.set) | ({} if args.out is None else {"out": str(args.out)})
    recipe = read_recipe(args.recipe, **changes)
    training = Training(recipe, ImageStream(recipe))
    if training.finished:
        print(f"{recipe.out}: already trained on all {recipe.images} images")
    try:
        for line in training.run():
            print(json.dumps(line), flush=True)
    except FloatingPointError as error:
        print(f"dynahoi pretrain: {error}; the last save is in {recipe.out}", file=sys.stderr)
        return 1
    return 0
