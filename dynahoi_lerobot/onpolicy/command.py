"""``dynahoi dagger``: train a policy on its own states, in memory, as a recipe says."""

from __future__ import annotations

import argparse
import importlib
import sys
from typing import Any

from tqdm import tqdm

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.onpolicy.dagger import CHECKPOINT, Dagger
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe, read_recipe

FAILED = 1
BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"
"""Of a progress in fractions of rounds, which nobody wants to read."""


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
        _run(dagger, recipe.rounds)
    except FloatingPointError as error:
        print(f"dynahoi dagger: {error}; the last save is in {recipe.out}", file=sys.stderr)
        return FAILED
    print(f"{recipe.out / CHECKPOINT}")
    return 0


def _run(dagger: Dagger, rounds: int) -> None:
    """Train, with a progress bar, and print a line a round."""
    with tqdm(total=rounds, initial=dagger.round, desc="training", bar_format=BAR, disable=None) as bar:
        for line in dagger.run(lambda done: bar.update(done - bar.n)):
            bar.write(_told(line, rounds))


def learner_module(policy: dict[str, Any]) -> Any:
    """Import the module that trains policies of a type.

    Raises:
        ValueError: if there is none, naming the type received.
    """
    kind = policy.get("type", "")
    try:
        return importlib.import_module(f"lerobot_policy_{kind}.learner")
    except ModuleNotFoundError as error:
        raise ValueError(f"policy.type must name a policy with a learner, such as tracker, got {kind!r}") from error


def _told(line: dict[str, Any], rounds: int) -> str:
    text = f"round {line['round']}/{rounds}, {line['processor_minutes']:.1f} processor minutes, loss {line['loss']}"
    for split in ("train", "val"):
        found = {name: value for name, value in line.get(split, {}).items() if value is not None}
        text += "".join(f", {split} {name} {value}" for name, value in found.items())
    return text
