"""``dynahoi generate``: the command's arguments, progress and summary.

With ``--actor`` a policy moves the hand, and the expert labels its states.
"""

import argparse
import json
import sys
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from dynahoi_lerobot.core.arguments import add_field_arguments, given_fields, number, path, whole
from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import FileLimits, check_root
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.evaluate.arguments import add_trust_argument
from dynahoi_lerobot.generate.actor import actor_name, make_actor, open_policy, runtime
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan, Record, shard_size
from dynahoi_lerobot.rollout import loop
from dynahoi_lerobot.sampling.recipe import Recipe, load_recipe

RECIPE_OPTIONS = tuple(entry.name for entry in fields(Recipe) if entry.name != "actor")
"""Fields of the recipe that options of the command override; ``--actor`` takes a checkpoint, not its name."""
ENCODING_OPTIONS = tuple(entry.name for entry in fields(Encoding))
EXECUTORS = ("local", "slurm", "ray")
LONGEST_VIDEO_S = 1e9
"""No dataset is longer."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi generate``."""
    parser.add_argument("--root", type=path, required=True, help="dataset folder; an incomplete one is resumed")
    parser.add_argument("--recipe", type=path, help="YAML file; the options below override it")
    parser.add_argument("--episodes", type=int, required=True, help="number of episodes")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first episode; episode i has seed + i")
    add_field_arguments(parser, Recipe, RECIPE_OPTIONS)
    parser.add_argument(
        "--subtasks", action="store_true", help="store the current subtask in LeRobot's language column"
    )
    parser.add_argument("--workers", type=whole(1, 4096), default=1, help="number of processes")
    parser.add_argument(
        "--shard-episodes", type=int, help="episodes per shard; by default an eighth of all, at most 256"
    )
    add_field_arguments(parser, Encoding, ENCODING_OPTIONS)
    parser.add_argument(
        "--video-seconds",
        type=number(1.0, LONGEST_VIDEO_S),
        default=FileLimits.video_s,
        help="maximum length of a video file [s], and at most 200 MB; LeRobot can only stream one file per view",
    )
    parser.add_argument("--executor", choices=EXECUTORS, help="run the shards as datatrove tasks")
    parser.add_argument("--tasks", type=whole(1, 100_000), help="number of tasks; one per shard by default")
    parser.add_argument("--dry-run", action="store_true", help="print what --executor would do")
    parser.add_argument("--partition", default="cpu", help="Slurm partition")
    parser.add_argument("--time", default="24:00:00", help="Slurm time limit per task")
    parser.add_argument("--cpus-per-task", type=whole(1, 4096), default=1, help="Slurm CPUs per task")
    parser.add_argument("--gpus-per-task", type=whole(0, 64), default=0, help="Slurm GPUs per task")
    parser.add_argument("--json", type=path, help="also write the summary to this file")
    parser.add_argument(
        "--actor", metavar="CHECKPOINT", help="policy that moves the hand while the expert labels its states"
    )
    add_trust_argument(parser)


def run(args: argparse.Namespace, *, record: Record | None = None, recipe: Recipe | None = None) -> int:
    """Generate a dataset and print a JSON summary.

    Args:
        args: the parsed arguments of ``add_arguments``.
        record: plays the expert without ``--actor``; ``dynahoi_lerobot.rollout.loop.record`` by default.
        recipe: what the options override; that of ``--recipe``, or the default recipe, by default.

    Returns:
        The exit code, 0.
    """
    check_output(args.root)
    check_root(args.root)
    complete = args.root.exists()
    recipe, runs_on = recipe or load_recipe(args.recipe), ""
    if args.actor is not None:
        recipe, record, runs_on = _on_policy(args, recipe)
    plan = _plan(args, recipe, runs_on)
    if args.executor is not None:
        from dynahoi_lerobot.generate import executors

        resources = executors.ClusterResources(
            args.tasks, -1 if args.workers == 1 else args.workers, args.cpus_per_task,
            gpus_per_task=args.gpus_per_task, partition=args.partition, time=args.time,
        )  # fmt: skip
        recorder = record or partial(loop.record, threads=args.cpus_per_task)
        work = (args.executor, plan, args.root, recorder, resources)
        if args.dry_run or not executors.run(*work):
            print(executors.describe(*work))
            return 0
    record = record or partial(loop.record, threads=_threads(args))
    with tqdm(total=plan.episodes, desc="generating", unit="episode", smoothing=0.05, disable=None) as bar:
        manifest = generate(
            plan, args.root, record=record, workers=args.workers, progress=lambda done: bar.update(done - bar.n)
        )
    if complete:
        print(f"{args.root} was already complete and agrees with its manifest", file=sys.stderr)
    summary = _summary(args.root, manifest)
    print(json.dumps(summary, indent=2))
    if args.json:
        args.json.write_text(json.dumps(summary, indent=2))
    return 0


def _on_policy(args: argparse.Namespace, recipe: Recipe) -> tuple[Recipe, Record, str]:
    """Return the recipe for the policy of ``--actor``, its recorder, and its ``runtime``."""
    policy, name = open_policy(args.actor, trust=args.trust), actor_name(args.actor)
    if recipe.actor not in ("", name):
        raise ValueError(f"the recipe names the actor {recipe.actor}; --actor {args.actor} is {name}")
    views = tuple(dict.fromkeys((*recipe.views, *policy.views)))
    trained = {key: policy.trained_for[key] for key in ("control_mode", "image_size") if key in policy.trained_for}
    recipe = replace(recipe, actor=name, views=views, **trained)
    runs_on = runtime(policy)
    make = partial(make_actor, path=args.actor, name=name, on=runs_on, trust=args.trust)
    return recipe, partial(loop.record_on_policy, make_agent=make, threads=_threads(args)), runs_on


def _threads(args: argparse.Namespace) -> int:
    """Return how many threads share the worlds of one process: all cores (0) if it is the only one."""
    return 0 if args.workers == 1 else 1


def _plan(args: argparse.Namespace, recipe: Recipe, runs_on: str) -> GenerationPlan:
    if recipe.actor and args.actor is None:
        raise ValueError(f"the recipe names the actor {recipe.actor}; give its checkpoint with --actor")
    return GenerationPlan(
        recipe.changed(**given_fields(args, RECIPE_OPTIONS)),
        args.episodes,
        args.seed,
        _encoding(args),
        FileLimits(video_s=args.video_seconds),
        shard_size(args.episodes) if args.shard_episodes is None else args.shard_episodes,
        runtime=runs_on,
        subtasks=args.subtasks,
    )


def _encoding(args: argparse.Namespace) -> Encoding:
    given = given_fields(args, ENCODING_OPTIONS)
    encoding = Encoding(**given)
    settings = [name for name in given if name != "codec"]
    if settings and not encoding.is_video:
        raise ValueError(f"{settings[0]} is {given[settings[0]]!r}; images has none, only a video has")
    return encoding


def _summary(root: Path, manifest: Manifest) -> dict[str, Any]:
    size = sum((root / name).stat().st_size for name in manifest.files)
    yields = manifest.yields
    return {
        "root": str(root),
        "episodes": manifest.episodes,
        "frames": manifest.frames,
        "megabytes": round(size / 1e6, 1),
        "yield": round((yields["kept"] - yields["failed"]) / yields["tried"], 4),
        "failed": yields["failed"],
        "rejected": yields["rejected"],
        "sha256": manifest.digest,
    }
