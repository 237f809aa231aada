"""``dynahoi play``: a page on which a person catches, is scored and records demonstrations."""

from __future__ import annotations

import argparse
import asyncio
import secrets
from contextlib import ExitStack, suppress
from dataclasses import replace

from dynahoi_lerobot.core.arguments import add_field_arguments, given_fields, path, whole
from dynahoi_lerobot.core.conventions import SEED_LIMIT
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.files import new_folder
from dynahoi_lerobot.dataset.columns import dataset_features
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.evaluate.arguments import EXPERT_ALIAS, add_trust_argument, make_actor, playing_rules
from dynahoi_lerobot.evaluate.table import results_table
from dynahoi_lerobot.play.game import Game
from dynahoi_lerobot.play.live_world import LiveWorld
from dynahoi_lerobot.play.scores import scores_of
from dynahoi_lerobot.play.server import LOOPBACK, PlayServer
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import kind_seed, kind_seeds

RECIPE_OPTIONS = ("control_class", "capture", "hand", "protocol", "image_size", "path_speed")
"""Fields of the recipe that are options of the command."""
IMAGE_PX = 192


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi play``."""
    parser.add_argument("--name", default="anonymous", help="the player's name in results: human:NAME")
    parser.add_argument("--split", default="val", help="stream of the scored episodes; practice is on train")
    parser.add_argument("--motion", help="play this kind of motion only")
    parser.add_argument("--episodes", type=whole(1, 10_000), default=20, help="number of scored episodes")
    parser.add_argument("--first", type=whole(0, SEED_LIMIT - 1), default=0, help="number of the first scored episode")
    parser.add_argument("--out", type=path, help="folder for the results; an interrupted evaluation goes on there")
    parser.add_argument("--record", type=path, metavar="DATASET", help="write the scored episodes as a LeRobotDataset")
    parser.add_argument("--policy", help="also show how this checkpoint or baseline plays the same episodes")
    add_trust_argument(parser)
    add_field_arguments(parser, Recipe, RECIPE_OPTIONS)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on; others than loopback add a token")
    parser.add_argument("--port", type=whole(0, 65535), default=8765, help="port to listen on; 0 takes a free one")


def run(args: argparse.Namespace) -> int:
    """Serve the page until interrupted or all episodes are played; return the exit code.

    Raises:
        ValueError: for an unknown name, a folder that holds something else, or an address that is in use.
    """
    given = given_fields(args, RECIPE_OPTIONS)
    actors = [make_actor(EXPERT_ALIAS, given.get("capture", Recipe.capture))]
    if args.policy:
        actors.append(make_actor(args.policy, given.get("capture", Recipe.capture), trust=args.trust))
    recipe = Recipe(split=args.split, image_size=IMAGE_PX).changed(**playing_rules(given, actors[-1]))
    if not recipe.image_size:
        raise ValueError("--image-size is 0, but a player needs to see; leave it out")
    seeds = {number: kind_seed(recipe, args.motion, number) for number in range(args.first, args.first + args.episodes)}
    if len(set(seeds.values())) < len(seeds):
        raise ValueError(f"--episodes must be at most {len(kind_seeds(recipe, args.motion))}, all there are")
    with ExitStack() as stack:
        scores = stack.enter_context(scores_of(f"human:{args.name}", recipe, args.out))
        writer: DatasetWriter | None = None

        def keep(episode: Episode) -> None:
            nonlocal writer
            if args.record and writer is None:
                folder = stack.enter_context(new_folder(args.record))
                writer = stack.enter_context(DatasetWriter(folder, dataset_features(episode)))
            if writer is not None:
                writer.add(episode)
            scores.add(episode)

        left = [number for number, seed in seeds.items() if seed not in scores.results.seeds]
        practice = replace(recipe, split="train", path_speed=1.0)
        practised = args.motion if args.motion in practice.motion_names else None
        game = Game(
            LiveWorld(recipe, args.motion, record_images=True),
            LiveWorld(practice, practised, record_images=True),
            numbers=left,
            total=args.episodes,
            player=scores.results.info.policy,
            others=actors,
            keep=keep,
        )
        token = "" if args.host in LOOPBACK else secrets.token_urlsafe(16)
        with suppress(KeyboardInterrupt):
            asyncio.run(PlayServer(game, args.host, args.port, token).run(_announce))
        if writer is not None:
            writer.finish({"recipe": recipe.stored()})
    if scores.results.rows:
        print(results_table([scores.results]))
    return 0


def _announce(address: str) -> None:
    print(f"play at {address}; Ctrl-C ends it", flush=True)
