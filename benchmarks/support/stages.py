"""The stages of generation by themselves: what each could do alone, and its share of a process that
does all.
"""

import functools
import os
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from dynahoi_lerobot.dataset import write_episodes, writer
from dynahoi_lerobot.dataset.video import Encoding, encode
from dynahoi_lerobot.rollout import loop as rollout
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from dynahoi_lerobot.world.sensors import Cameras

WORLDS = 32
STEPS = 40
WARM_UP_EPISODES = 4
STAGE_FUNCTIONS = {
    "sampling": [(rollout, "sample_specs")],
    "physics": [(WorldBatch, "step"), (WorldBatch, "reset")],
    "render": [(Cameras, "render")],
    "encode": [(writer, "encode")],
}
"""What counts for a stage; none of these calls another. A profiler would mix up threads that call
back into Python."""


def stages_alone(image_size: int) -> dict[str, float]:
    """Return frames/s of physics, rendering and encoding, each alone on all cores."""
    batch = WorldBatch(Rules(image_size=image_size), WORLDS)
    batch.reset(range(WORLDS), sample_specs(Recipe(split="test"), range(WORLDS)))
    images = batch.cameras.render()
    rates = {
        "physics": WORLDS / _seconds(lambda: batch.step(batch.executed)),
        "render": WORLDS / _seconds(batch.cameras.render),
    }
    cores = os.cpu_count() or 1
    with get_context("spawn").Pool(cores) as pool:
        rates["encode"] = sum(pool.map(partial(_encode_rate, images), range(cores)))
    return rates


def _seconds(task: Callable[[], object]) -> float:
    task()
    begin = time.perf_counter()
    for _ in range(STEPS):
        task()
    return (time.perf_counter() - begin) / STEPS


def _encode_rate(images: np.ndarray, process: int) -> float:
    del process
    return len(images) / _seconds(lambda: encode(images, Encoding()))


def stage_shares(image_size: int, episodes: int) -> dict[str, float]:
    """Return each stage's share, and that of all the rest, of one process on one thread that writes
    a dataset.
    """
    seconds = dict.fromkeys(STAGE_FUNCTIONS, 0.0)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as patches:
        _write(Path(folder) / "warm", image_size, range(WARM_UP_EPISODES))
        for stage, functions in STAGE_FUNCTIONS.items():
            for owner, name in functions:
                timed = _timed(getattr(owner, name), partial(_add, seconds, stage))
                patches.enter_context(mock.patch.object(owner, name, timed))
        begin = time.perf_counter()
        _write(Path(folder) / "measured", image_size, range(episodes))
        total = time.perf_counter() - begin
    shares = {stage: spent / total for stage, spent in seconds.items()}
    return shares | {"bookkeeping": 1.0 - sum(shares.values())}


def _timed(function: Callable[..., Any], add: Callable[[float], None]) -> Callable[..., Any]:
    @functools.wraps(function)
    def run(*args: Any, **kwargs: Any) -> Any:
        begin = time.perf_counter()
        try:
            return function(*args, **kwargs)
        finally:
            add(time.perf_counter() - begin)

    return run


def _add(seconds: dict[str, float], stage: str, more: float) -> None:
    seconds[stage] += more


def _write(root: Path, image_size: int, seeds: range) -> None:
    write_episodes(root, record(Recording.of(image_size=image_size), seeds, threads=1))
