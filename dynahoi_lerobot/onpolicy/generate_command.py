"""``dynahoi generate``: with ``--actor`` a policy moves the hand, and the expert's commands become the labels."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from typing import Any

from dynahoi_lerobot.core.arguments import number
from dynahoi_lerobot.evaluate.arguments import add_trust_argument
from dynahoi_lerobot.generate import command
from dynahoi_lerobot.onpolicy.actor import actor_name, make_actor, open_policy, runtime
from dynahoi_lerobot.rollout.teacher_labels import MakeAgent, record_on_policy
from dynahoi_lerobot.sampling.recipe import Recipe, load_recipe

TEACHER_SHARE = 0.15
"""Share of the episodes that the teacher leads beside a policy, where nothing is said."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi generate``."""
    command.add_arguments(parser)
    parser.add_argument(
        "--actor", metavar="CHECKPOINT", help="policy that moves the hand; the expert's commands become the labels"
    )
    parser.add_argument(
        "--teacher-share",
        type=number(0.0, 1.0),
        help=f"share of the episodes that the expert leads, disturbed: {TEACHER_SHARE} with --actor; 1 needs no actor",
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
    if args.teacher_share is not None:
        recipe = replace(recipe, teacher_share=args.teacher_share)
    if recipe.on_policy:
        return command.run(args, recipe=recipe, record=_record(args, None))
    return command.run(args, recipe=recipe)


def _run_policy(args: argparse.Namespace, recipe: Recipe) -> int:
    policy = open_policy(args.actor, trust=args.trust)
    name = actor_name(args.actor)
    if recipe.actor not in ("", name):
        raise ValueError(f"the recipe names the actor {recipe.actor}; --actor {args.actor} is {name}")
    share = recipe.teacher_share or TEACHER_SHARE if args.teacher_share is None else args.teacher_share
    changes: dict[str, Any] = {"actor": name, "teacher_share": share}
    if policy.image_size is not None:
        changes["image_size"] = policy.image_size
    changes["views"] = tuple(dict.fromkeys((*recipe.views, *policy.views)))
    on = runtime(policy)
    make = partial(make_actor, path=args.actor, name=name, on=on, trust=args.trust)
    return command.run(args, recipe=replace(recipe, **changes), record=_record(args, make), runtime=on)


def _record(args: argparse.Namespace, make_agent: MakeAgent | None) -> partial[Any]:
    """Return the recorder; one process uses all cores for physics."""
    threads = 0 if args.workers == 1 else 1
    return partial(record_on_policy, make_agent=make_agent, threads=threads)
