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
KNOWN_FRAMES_S, KNOWN_QUICKSTART_MIN = 250.0, 5.0
"""Pace of a machine with two cores, and how long the quickstart took there."""


@part("pace")
def pace(folder: Path) -> Iterator[Fact]:
    """Yield the pace over some episodes of ``train``, sampling included, and an estimate from it."""
    del folder
    frames_s = frames_per_s()
    minutes = KNOWN_QUICKSTART_MIN * KNOWN_FRAMES_S / frames_s
    yield Fact("pace", f"{frames_s:.0f} frames/s at {RECIPE.image_size} px", f"the quickstart takes {minutes:.0f} min")


def frames_per_s() -> float:
    """Return how many frames of the expert's episodes are played and drawn in a second."""
    for _ in record(RECIPE, [0]):  # compiles the scene and, once on a machine, the renderer
        pass
    start = time.perf_counter()
    frames = sum(len(episode) for episode in record(RECIPE, range(1, 1 + EPISODES)))
    return frames / (time.perf_counter() - start)
