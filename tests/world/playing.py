"""Playing worlds by hand, and reducing what happened to a hash."""

import hashlib
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from dynahoi_lerobot.core.agent import Actor
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.world.batch import WorldBatch

SMALL = Recipe.of(split="test", image_size=32)


def world(specs: Sequence[EpisodeSpec], *, threads: int = 1, **options) -> WorldBatch:
    """A batch with one world for each spec, at the start of its episode; ``options`` are fields of
    the rules.
    """
    batch = WorldBatch(changed(SMALL.rules, options), len(specs), threads)
    batch.reset(range(len(specs)), specs)
    return batch


def wait(batch: WorldBatch) -> None:
    """Step until every world is in its control phase; worlds that are there hold still."""
    while not batch.acting.all():
        batch.step(batch.executed)


def played(
    rules: Rules, actor: Actor, specs: Sequence[EpisodeSpec], *, images: bool = False
) -> list[Episode]:
    """The evaluation of each episode in a world of its own, in the order of their seeds."""
    batch = WorldBatch(rules, len(specs), threads=1)
    episodes = evaluate(batch, actor, specs, images=images)
    return sorted(episodes, key=lambda episode: episode.meta.seed)


def digest(episode: Episode) -> str:
    """Hash of every number, pixel and word of an episode, but not of the code that made it."""
    sha = hashlib.sha256(repr(replace(episode.meta, code="")).encode())
    for field in fields(episode):
        value = getattr(episode, field.name)
        if isinstance(value, np.ndarray):
            sha.update(value.tobytes())
        elif field.name == "images":
            for view, images in value.items():
                sha.update(view.encode() + images.tobytes())
        elif field.name != "meta":
            sha.update(repr(value).encode())
    return sha.hexdigest()


def digests(
    specs: Sequence[EpisodeSpec], size: int, threads: int = 1, *, images: bool = False
) -> dict[int, str]:
    """Hash of the expert's evaluation of each seed, played ``size`` worlds at a time."""
    batch = WorldBatch(SMALL.rules, size, threads)
    episodes = evaluate(batch, EXPERTS["intercept"](), specs, images=images)
    return {episode.meta.seed: digest(episode) for episode in episodes}
