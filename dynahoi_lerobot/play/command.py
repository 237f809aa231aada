"""``dynahoi play``: a page on which a person catches, is scored and records demonstrations."""

import asyncio
import secrets
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.arguments import given_of, option, whole
from dynahoi_lerobot.core.conventions import SEED_LIMIT
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import privileged_features
from dynahoi_lerobot.core.files import new_folder
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.evaluate.actors import (
    AS_TRAINED,
    EXPERT_ALIAS,
    TRUST,
    make_actor,
    playing_rules,
)
from dynahoi_lerobot.evaluate.results import RunInfo, kept_results
from dynahoi_lerobot.evaluate.table import results_table
from dynahoi_lerobot.play.game import Game
from dynahoi_lerobot.play.live_world import LiveWorld
from dynahoi_lerobot.play.server import LOOPBACK, PlayServer
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import kind_seed, kind_seeds

IMAGE_PX = 192


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi play``."""

    name: str = option("anonymous", "the player's name in results: human:NAME")
    split: str = option("val", "split of the scored episodes; practice episodes come from train")
    motion: str | None = option(None, "play this kind of motion only")
    episodes: int = option(20, "number of scored episodes", whole(1, 10_000))
    first: int = option(0, "number of the first scored episode", whole(0, SEED_LIMIT - 1))
    out: Path | None = option(None, "result folder; an incomplete one is resumed")
    record: Path | None = option(
        None, "write the scored episodes as a LeRobotDataset", metavar="DATASET"
    )
    policy: str | None = option(
        None, "also show how this checkpoint or baseline plays the same episodes"
    )
    trust: bool = option(False, TRUST)
    given: dict[str, Any] = given_of(Recipe, AS_TRAINED)
    host: str = option(
        "127.0.0.1", "address to listen on; any other than loopback requires a token"
    )
    port: int = option(8765, "port to listen on; 0 chooses a free one", whole(0, 65535))


def run(options: Options) -> int:
    """Serve the page until interrupted or all episodes are played; return the exit code.

    Raises:
        FileExistsError: if the dataset to record exists.
        ValueError: for an unknown name, a folder that holds something else, or an address that is
            in use.
    """
    if options.record and options.record.exists():
        raise FileExistsError(f"{options.record} exists; choose a new folder")
    capture = options.given.get("capture", Rules.capture)
    actors = [make_actor(EXPERT_ALIAS, capture)]
    if options.policy:
        actors.append(make_actor(options.policy, capture, trust=options.trust))
    recipe = changed(
        Recipe(rules=Rules(image_size=IMAGE_PX), split=options.split),
        playing_rules(options.given, actors[-1]),
    )
    if not recipe.rules.image_size:
        raise ValueError("--image-size is 0, but a player needs to see; leave it out")
    seeds = {
        number: kind_seed(recipe, options.motion, number)
        for number in range(options.first, options.first + options.episodes)
    }
    if len(set(seeds.values())) < len(seeds):
        raise ValueError(
            f"--episodes must be at most {len(kind_seeds(recipe, options.motion))}, all there are"
        )
    info = RunInfo.begun(f"human:{options.name}", recipe, inference="")
    with ExitStack() as stack:
        results = stack.enter_context(kept_results(options.out, info))
        writer: DatasetWriter | None = None

        def keep(episode: Episode) -> None:
            nonlocal results, writer
            columns = (*recipe.rules.features, *privileged_features())
            if options.record and writer is None:
                folder = stack.enter_context(new_folder(options.record))
                writer = stack.enter_context(DatasetWriter(folder, columns))
            if writer is not None:
                writer.add(episode)
            results = results.plus([episode])
            if options.out:
                results.write()

        left = [number for number, seed in seeds.items() if seed not in results.seeds]
        practice = replace(recipe, split="train", path_speed=1.0)
        practised = options.motion if options.motion in practice.motion_names else None
        game = Game(
            LiveWorld(recipe, options.motion, record_images=True),
            LiveWorld(practice, practised, record_images=True),
            numbers=left,
            total=options.episodes,
            player=info.policy,
            others=actors,
            keep=keep,
        )
        token = "" if options.host in LOOPBACK else secrets.token_urlsafe(16)
        with suppress(KeyboardInterrupt):
            asyncio.run(PlayServer(game, options.host, options.port, token).run(_announce))
        if writer is not None:
            writer.finish({"recording": {"recipe": recipe.stored()}})
    if results.rows:
        print(results_table([results]))
    return 0


def _announce(address: str) -> None:
    print(f"play at {address}; Ctrl-C ends it", flush=True)
