"""Grasp success per frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.panels import scaled
from dynahoi_lerobot.report.style import INK, legend, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SETTINGS = ("loose", "medium", "strict")


@figure("per-frame-grasp", "Grasp, frame by frame", place=70)
def per_frame_grasp(entries: Sequence[Entry]) -> Figure:
    """The share of control frames in which at least 3, 4 or 5 fingers are at the reference grasp.

    Figure "Grasp success rate under per-frame evaluation". A hand is rightly open on its way, so 100 % is not
    the aim.
    """
    drawing, (panel,) = new_figure(1, 1, 3.0)
    width = 0.8 / len(entries)
    for place, entry in enumerate(entries):
        values, errors = scaled([entry.summary[f"grasp_{setting}"] for setting in SETTINGS])
        x = np.arange(len(SETTINGS)) + (place - (len(entries) - 1) / 2) * width
        style = {"ecolor": INK, "capsize": 2, "error_kw": {"lw": 1}}
        panel.bar(x, values, 0.9 * width, yerr=errors, color=entry.colour, **style)
    panel.set_xticks(range(len(SETTINGS)), [f"{s}\n≥ {n} fingers" for s, n in zip(SETTINGS, (3, 4, 5), strict=True)])
    panel.set_ylabel("frames [%]")
    panel.grid(visible=False, axis="x")
    legend(drawing, entries)
    return drawing
