"""Grasp magnitude against travel, object by object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.evaluate.episode_row import Row
from dynahoi_lerobot.report.entries import Entry, distinct_episodes
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.style import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = "tab20"


@figure("grasp-magnitude", "Grasp and travel", place=105)
def grasp_magnitude(entries: Sequence[Entry]) -> Figure:
    """How far the reference grasp closes the hand [rad, mean of 15 joints] and how far the hand travels, per episode.

    Figure "Data statistics" b: small objects need large grasps, and each object is caught from near and far. Objects
    are listed from the largest grasp to the smallest.
    """
    import matplotlib as mpl

    objects = by_object(distinct_episodes(entries))
    drawing, (panel,) = new_figure(1, 1, 4.2)
    for place, (name, points) in enumerate(objects.items()):
        panel.scatter(*points.T, s=14, color=mpl.colormaps[COLOURS](place % 20), label=name, edgecolors="none")
    panel.set(xlabel="straight distance to the intercept [u]", ylabel="grasp [rad]")
    drawing.legend(loc="outside right upper")
    return drawing


def by_object(rows: Sequence[Row]) -> dict[str, np.ndarray]:
    """Return (K, 2) travel [u] and grasp [rad] of each object's episodes, the largest mean grasp first."""
    points = {
        name: np.array([[row["travel_u"], row["grasp_rad"]] for row in rows if row["object"] == name])
        for name in sorted({row["object"] for row in rows})
    }
    return dict(sorted(points.items(), key=lambda item: -item[1][:, 1].mean()))
