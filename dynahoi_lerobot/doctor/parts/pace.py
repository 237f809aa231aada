"""How fast this machine plays and draws episodes, and how long the quickstart takes at that pace."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from dynahoi_lerobot.doctor.parts.base import Fact, part
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.recipe import Recipe

RECIPE = Recipe(image_size=64)
EPISODES = 16
KNOWN_FRAMES_S, KNOWN_QUICKSTART_MIN = 720.0, 4.0
"""Pace of a core, and the processor time of the quickstart there, nearly all of it one after another."""


@part("pace")
def pace(folder: Path) -> Iterator[Fact]:
    """Yield the pace over some episodes of ``train``, sampling included, and an estimate from it."""
    del folder
    frames_s = frames_per_s()
    minutes = KNOWN_QUICKSTART_MIN * KNOWN_FRAMES_S / frames_s
    found = f"{frames_s:.0f} frames/s of one idle core at {RECIPE.image_size} px"
    yield Fact("pace", found, f"the quickstart takes about {max(1.0, minutes):.0f} min")


def frames_per_s() -> float:
    """Return how many frames of the expert's episodes a thread plays and draws in a second of processor time."""
    for _ in record(RECIPE, [0], threads=1):  # compiles the scene and, once on a machine, the renderer
        pass
    start = time.process_time()
    frames = sum(len(episode) for episode in record(RECIPE, range(1, 1 + EPISODES), threads=1))
    return frames / (time.process_time() - start)
