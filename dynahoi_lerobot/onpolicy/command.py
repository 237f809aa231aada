"""``dynahoi dagger``: train a policy on its own states, in memory, as a recipe says."""

from __future__ import annotations

import argparse
import importlib
import sys
from typing import Any

from dynahoi_lerobot.foundation.arguments import path
from dynahoi_lerobot.onpolicy.dagger import CHECKPOINT, Dagger
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe, read_recipe

FAILED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi dagger``."""
    parser.add_argument("--recipe", type=path, required=True, help="YAML file, such as recipes/train/standard.yaml")
    parser.add_argument("--out", type=path, help="folder of the run instead of the recipe's; goes on where it stopped")


def run(args: argparse.Namespace) -> int:
    """Train, print a line a round, and return the exit code: 0 done, 1 the loss was not finite."""
    changes = {} if args.out is None else {"out": args.out}
    recipe = read_recipe(DaggerRecipe, args.recipe, **changes)
    dagger = Dagger(recipe, learner_module(recipe.policy).make_learner(recipe))
    try:
        for line in dagger.run():
            print(_told(line, recipe.rounds), flush=True)
    except FloatingPointError as error:
        print(f"dynahoi dagger: {error}; the last save is in {recipe.out}", file=sys.stderr)
        return FAILED
    print(f"{recipe.out / CHECKPOINT}")
    return 0


def learner_module(policy: dict[str, Any]) -> Any:
    """Import the module that trains policies of a type.

    Raises:
        ValueError: if there is none, naming the type received.
    """
    kind = policy.get("type", "")
    try:
        return importlib.import_module(f"lerobot_policy_{kind}.learner")
    except ModuleNotFoundError as error:
        raise ValueError(f"policy.type must name a policy with a learner, such as obact, got {kind!r}") from error


def _told(line: dict[str, Any], rounds: int) -> str:
    text = f"round {line['round']}/{rounds}, {line['processor_minutes']:.1f} processor minutes, loss {line['loss']}"
    for split in ("train", "val"):
        found = {name: value for name, value in line.get(split, {}).items() if value is not None}
        text += "".join(f", {split} {name} {value}" for name, value in found.items())
    return text
