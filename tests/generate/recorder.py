"""A recorder that needs no simulator; other processes import it."""

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import REDRAW_STRIDE
from tests.dataset.episodes import varied_episode


@dataclass(frozen=True)
class FakeRecording(Recording):
    recipe: Recipe = field(default_factory=lambda: Recipe.of(image_size=16))
    name: str = "fake"
    miss_every: int = 0
    """Every first draw that this divides is missed by the expert; 0 for none."""
    hopeless: bool = False
    """The expert misses everything."""


PLAN = GenerationPlan(FakeRecording(), 5, shard_episodes=2)
"""Five episodes in three shards."""


def record(recording: FakeRecording, seeds: Sequence[int]) -> Iterator[Episode]:
    for seed in seeds:
        first_draw = seed < REDRAW_STRIDE
        if not (
            recording.hopeless
            or (recording.miss_every and first_draw and seed % recording.miss_every == 0)
        ):
            yield varied_episode(seed, recording.recipe.rules.image_size)


def record_slowly(recording: FakeRecording, seeds: Sequence[int]) -> Iterator[Episode]:
    for episode in record(recording, seeds):
        time.sleep(0.01)
        yield episode


def record_the_last_after(
    sign: Path, recording: FakeRecording, seeds: Sequence[int]
) -> Iterator[Episode]:
    """Seed 9 is recorded once the file ``sign`` is there; a minute is waited for it."""
    for episode in record(recording, seeds):
        end_s = time.monotonic() + 60
        while episode.meta.seed == 9 and not sign.exists() and time.monotonic() < end_s:
            time.sleep(0.01)
        yield episode


def record_with_nan(recording: FakeRecording, seeds: Sequence[int]) -> Iterator[Episode]:
    """Seeds below 100 that end in 3 give a corrupt recording."""
    for episode in record(recording, seeds):
        if episode.meta.seed % 10 == 3 and episode.meta.seed < 100:
            state = episode.state.copy()
            state[5, 2] = np.nan
            yield replace(episode, state=state)
        else:
            yield episode


def record_and_die_once(recording: FakeRecording, seeds: Sequence[int]) -> Iterator[Episode]:
    """The first process that comes here dies in the middle of its shard."""
    marker = Path(recording.name)
    for number, episode in enumerate(record(recording, seeds)):
        if number == 1 and not marker.exists():
            marker.touch()
            os._exit(9)
        yield episode


def record_and_die(recording: FakeRecording, seeds: Sequence[int]) -> Iterator[Episode]:
    yield from record(recording, seeds[:1])
    os._exit(9)
