"""``dynahoi pretrain``: train a policy's eye on pictures of random configurations, as a recipe says."""

from __future__ import annotations

import argparse

import numpy as np

from dynahoi_lerobot.foundation.arguments import path
from dynahoi_lerobot.onpolicy.command import learner_module
from dynahoi_lerobot.onpolicy.recipe import EyeRecipe, read_recipe
from dynahoi_lerobot.onpolicy.snapshots import snapshots
from dynahoi_lerobot.sampling.sampler import sample_specs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi pretrain``."""
    parser.add_argument("--recipe", type=path, required=True, help="YAML file, such as recipes/train/eye.yaml")
    parser.add_argument("--out", type=path, help="folder that receives the eye instead of the recipe's")


def run(args: argparse.Namespace) -> int:
    """Train, print a line now and then, and return 0."""
    recipe = read_recipe(EyeRecipe, args.recipe, **({} if args.out is None else {"out": args.out}))
    learner = learner_module(recipe.policy)
    specs = sample_specs(recipe.episodes, range(recipe.n_episodes))
    stream = snapshots(recipe.episodes, specs, recipe.batch_size, np.random.default_rng(recipe.seed))
    for line in learner.train_eye(recipe, stream):
        print(line, flush=True)
    return 0
