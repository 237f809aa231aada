"""At which attempt the draws of the benchmark's episodes succeed, so that those before it need not
be tried again.

`accepted.npz` holds the number of the attempt for every seed of the splits of fixed size, as
`benchmarks/pin.py` found it by trying. It only saves time: where the draws of that attempt do not
fit, the episode is searched from the first.
"""

import functools
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from dynahoi_lerobot.sampling.recipe import Recipe

ENTRIES = Path(__file__).with_name("accepted.npz")
"""Attempts, counted from 1, by stream, in the order of the seeds; and ``benchmark``, whose episodes
they lead to."""


def accepted_attempts(recipe: Recipe) -> dict[int, int]:
    """Return the attempt that succeeds by the seeds of a recipe; nothing if its episodes are not
    the benchmark's own.

    They are where motions, objects, protocol, hand and the frames after the intercept are those of
    the split, without a salt. Nothing else has a part in what is rejected.
    """
    usual = Recipe(split=recipe.split)
    stream = recipe.split_definition.stream
    if recipe.salt or _decisive(recipe) != _decisive(usual) or stream not in _shipped():
        return {}
    return dict(enumerate(_shipped()[stream].tolist()))


def _decisive(recipe: Recipe) -> tuple[Any, ...]:
    rules = recipe.rules
    return (
        recipe.motion_names,
        recipe.object_names,
        rules.protocol,
        rules.hand_name,
        rules.capture_rule.hold_frames,
    )


@functools.cache
def _shipped() -> dict[str, np.ndarray]:
    """Return the attempts by stream; none if they are those of another benchmark."""
    with np.load(ENTRIES) as stored:
        return dict(stored) if stored["benchmark"] == BENCHMARK_ID else {}
