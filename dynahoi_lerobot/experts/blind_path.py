"""A baseline that sees nothing: the same path of the hand in every episode, found on episodes of ``train``."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from dynahoi_lerobot.experts.base import EXPERTS, SingleWorldExpert, WorldView
from dynahoi_lerobot.hands import HANDS

PATH_FILE = Path(__file__).with_suffix(".csv")
"""Palm positions relative to home [m], one line per frame from the first control step on; it is what
``benchmarks/validity.py --search`` finds."""


@EXPERTS.register("blind_path")
class BlindPath(SingleWorldExpert):
    """Goes along a fixed path from home with closed fingers; what it scores needs neither perception nor prediction."""

    name = "blind_path"
    privileged = False

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        path = fixed_path()
        step = min(world.due_frame - world.spec.window_frames, len(path) - 1)
        return np.concatenate([world.spec.home_pos_w + path[step], fist(world.spec.hand)])


@functools.cache
def fixed_path() -> np.ndarray:
    """Return (K, 3) palm positions relative to home [m] after 1, 2, ... control steps."""
    return np.loadtxt(PATH_FILE, delimiter=",", ndmin=2)


@functools.cache
def fist(hand: str) -> np.ndarray:
    """(15,) joint angles [rad] around an object of no size."""
    return HANDS[hand]().reference_joints(0.0)
