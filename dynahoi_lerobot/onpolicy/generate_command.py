"""``dynahoi generate``: with ``--actor`` a policy moves the hand, and the expert labels its states."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from typing import Any

from dynahoi_lerobot.evaluate.arguments import add_trust_argument
from dynahoi_lerobot.generate import command
from dynahoi_lerobot.onpolicy.actor import actor_name, make_actor, open_policy, runtime
from dynahoi_lerobot.rollout.loop import record_on_policy
from dynahoi_lerobot.sampling.recipe import Recipe, load_recipe


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi generate``."""
    command.add_arguments(parser)
    parser.add_argument(
        "--actor", metavar="CHECKPOINT", help="policy that moves the hand; the expert labels its states"
    )
    add_trust_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Generate a dataset, print a JSON summary and return the exit code.

    Raises:
        PolicyError: if the policy cannot be loaded or, without ``--trust``, could run code.
        ValueError: for any other bad argument.
    """
    recipe = load_recipe(args.recipe)
    if args.actor is not None:
        return _run_policy(args, recipe)
    if recipe.actor:
        raise ValueError(f"the recipe names the actor {recipe.actor}; give its checkpoint with --actor")
    return command.run(args, recipe=recipe)


def _run_policy(args: argparse.Namespace, recipe: Recipe) -> int:
    policy = open_policy(args.actor, trust=args.trust)
    name = actor_name(args.actor)
    if recipe.actor not in ("", name):
        raise ValueError(f"the recipe names the actor {recipe.actor}; --actor {args.actor} is {name}")
    changes: dict[str, Any] = {"actor": name}
    if "control_mode" in policy.trained_for:
        changes["control_mode"] = policy.trained_for["control_mode"]
    if policy.image_size is not None:
        changes["image_size"] = policy.image_size
    changes["views"] = tuple(dict.fromkeys((*recipe.views, *policy.views)))
    on = runtime(policy)
    make = partial(make_actor, path=args.actor, name=name, on=on, trust=args.trust)
    # one process uses all cores for physics
    record = partial(record_on_policy, make_agent=make, threads=0 if args.workers == 1 else 1)
    return command.run(args, recipe=replace(recipe, **changes), record=record, runtime=on)
