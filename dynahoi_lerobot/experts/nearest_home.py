"""A baseline that sees only where its home is in the world: it has a few paths, found on episodes of ``train``."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from dynahoi_lerobot.experts.base import EXPERTS, SingleWorldExpert, WorldView
from dynahoi_lerobot.experts.blind_path import fist
from dynahoi_lerobot.foundation.conventions import PALM_DOF

TABLE_FILE = Path(__file__).with_suffix(".csv")
"""One line for each home: its position [m], world, then palm positions relative to it [m], one for each frame from the
first control step on; it is what ``benchmarks/validity.py --search --homes`` finds."""


@EXPERTS.register("nearest_home")
class NearestHome(SingleWorldExpert):
    """Goes along the path of the tabled home that is nearest to its own; what it scores, the stage gives away.

    Policies cannot do this: they observe positions from their home, wherever that is.
    """

    name = "nearest_home"

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        homes_w, paths = home_table()
        path = paths[np.linalg.norm(homes_w - world.spec.home_pos_w, axis=1).argmin()]
        step = min(world.due_frame - world.spec.window_frames, len(path) - 1)
        return np.concatenate([world.spec.home_pos_w + path[step], fist(world.spec.hand)])


@functools.cache
def home_table() -> tuple[np.ndarray, np.ndarray]:
    """Return (H, 3) homes [m], world, and (H, K, 3) palm positions from there [m] after 1, 2, ... control steps."""
    table = np.loadtxt(TABLE_FILE, delimiter=",", ndmin=2)
    return table[:, :PALM_DOF], table[:, PALM_DOF:].reshape(len(table), -1, PALM_DOF)
