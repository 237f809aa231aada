"""How fast this machine plays and draws episodes, and how long the quickstart takes at that pace."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from dynahoi_lerobot.doctor.parts.base import Fact, part
from dynahoi_lerobot.doctor.parts.processor import cores
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.recipe import Recipe

RECIPE = Recipe(image_size=64)
EPISODES = 16
KNOWN_FRAMES_S = 593.0
"""Pace of a core of the machine on which the quickstart was timed."""
KNOWN_PROCESSOR_S, KNOWN_ELAPSED_S = 400.0, 276.0
"""Time of the whole quickstart there: of all processors together, and by the clock on two idle cores."""


@part("pace")
def pace(folder: Path) -> Iterator[Fact]:
    """Yield the pace over some episodes of ``train``, sampling included, and an estimate from it."""
    del folder
    frames_s = frames_per_s()
    found = f"{frames_s:.0f} frames/s of a core at {RECIPE.image_size} px"
    yield Fact("pace", found, f"the quickstart takes about {max(1.0, quickstart_s(frames_s, cores()) / 60):.0f} min")


def quickstart_s(frames_s: float, idle_cores: int) -> float:
    """Return how long the quickstart takes [s]; more than two cores count as two, for which it was timed.

    Args:
        frames_s: pace of a core [frames/s], as ``frames_per_s`` measures it.
        idle_cores: how many there are.
    """
    known_s = KNOWN_PROCESSOR_S if idle_cores == 1 else KNOWN_ELAPSED_S
    return known_s * KNOWN_FRAMES_S / frames_s


def frames_per_s() -> float:
    """Return how many frames of the expert's episodes a thread plays and draws in a second of processor time."""
    for _ in record(RECIPE, [0], threads=1):  # compiles the scene and, once on a machine, the renderer
        pass
    start = time.process_time()
    frames = sum(len(episode) for episode in record(RECIPE, range(1, 1 + EPISODES), threads=1))
    return frames / (time.process_time() - start)
