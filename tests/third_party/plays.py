"""Digests of what the benchmark plays, and a recording by name: run in a process of its own, with or without others.

python -m tests.third_party.plays [--register]
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from tests.third_party import register
from tests.world.playing import digest

EPISODES = 4
"""Of each split, at seeds of its own, so that all of them together have every kind of motion."""
SPLITS = [split for split in BENCHMARK.streams if len(Recipe(split=split).path_speeds) == 1]
"""The others are for evaluations alone."""


def episodes() -> Iterator[tuple[str, str]]:
    """Yield split and digest of the expert's recordings: specs, states and pixels."""
    for number, split in enumerate(SPLITS):
        recipe = Recipe(split=split, image_size=32, views=("ego_segmentation",))
        for episode in record(recipe, range(EPISODES * number, EPISODES * (number + 1))):
            yield f"{split}/{episode.meta.seed}", digest(episode)
    for episode in record(Recipe(split="train", capture="contact", image_size=16), range(EPISODES)):
        yield f"contact/{episode.meta.seed}", digest(episode)


def main() -> None:
    if "--register" in sys.argv:
        register()
    print(json.dumps(dict(episodes())))


if __name__ == "__main__":
    main()
