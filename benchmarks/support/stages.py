"""The stages of generation by themselves: what each could do alone, and its share of a process that
does all.
"""

import os
import tempfile
import time
import timeit
from collections.abc import Callable
from contextlib import ExitStack
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from support.isolated import added

from dynahoi_lerobot.dataset import write_episodes, writer
from dynahoi_lerobot.dataset.video import Encoding, encode
from dynahoi_lerobot.rollout import loop
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from dynahoi_lerobot.world.sensors import Cameras

WORLDS = 32
STEPS = 40
WARM_UP_EPISODES = 4
STAGE_FUNCTIONS: list[tuple[str, Any, str]] = [
    ("sampling", loop, "sample_specs"),
    ("physics", WorldBatch, "step"),
    ("physics", WorldBatch, "reset"),
    ("render", Cameras, "render"),
    ("encode", writer, "encode"),
]
"""What counts for a stage; none of these calls another. A profiler would mix up threads that call
back into Python."""


def stages_alone(image_size: int) -> dict[str, float]:
    """Return frames/s of physics, rendering and encoding, each alone on all cores."""
    batch = WorldBatch(Rules(image_size=image_size), WORLDS)
    batch.reset(range(WORLDS), sample_specs(Recipe(split="test"), range(WORLDS)))
    images = batch.cameras.render()
    cores = os.cpu_count() or 1
    rates = {
        "physics": WORLDS / _seconds(lambda: batch.step(batch.executed)),
        "render": WORLDS / _seconds(batch.cameras.render),
    }
    with get_context("spawn").Pool(cores) as pool:
        rates["encode"] = sum(pool.map(_encode_rate, [images] * cores))
    return rates


def _seconds(task: Callable[[], object]) -> float:
    """Return the mean time of a task that has run before."""
    task()
    return timeit.timeit(task, number=STEPS) / STEPS


def _encode_rate(images: np.ndarray) -> float:
    return len(images) / _seconds(lambda: encode(images, Encoding()))


def stage_shares(image_size: int, episodes: int) -> dict[str, float]:
    """Return each stage's share, and that of all the rest, of one process on one thread that writes
    a dataset.
    """
    seconds = {stage: 0.0 for stage, _, _ in STAGE_FUNCTIONS}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as patches:
        _write(Path(folder) / "warm", image_size, WARM_UP_EPISODES)
        for stage, owner, name in STAGE_FUNCTIONS:
            timed = added(seconds, stage)(getattr(owner, name))
            patches.enter_context(mock.patch.object(owner, name, timed))
        begin = time.perf_counter()
        _write(Path(folder) / "measured", image_size, episodes)
        total = time.perf_counter() - begin
    shares = {stage: spent / total for stage, spent in seconds.items()}
    return shares | {"bookkeeping": 1.0 - sum(shares.values())}


def _write(root: Path, image_size: int, episodes: int) -> None:
    recording = Recording.of(image_size=image_size)
    write_episodes(root, loop.record(recording, range(episodes), threads=1))
