"""The main metrics as bars."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynahoi_lerobot.evaluate.table import heading
from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.panels import ACROSS, columns_of, scaled
from dynahoi_lerobot.report.style import INK, hide_unused, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@figure("main", "Main metrics", place=10)
def main_metrics(entries: Sequence[Entry]) -> Figure:
    """The paper's seven metrics with 95 % intervals (Wilson for rates, bootstrap for means).

    An arrow in a title points towards better.
    """
    names = columns_of(entries)
    rows = -(-len(names) // ACROSS)
    drawing, axes = new_figure(rows, ACROSS, rows * (0.9 + 0.26 * len(entries)), sharey=True)
    hide_unused(axes, len(names))
    for panel, name in zip(axes, names, strict=False):
        values, errors = scaled([entry.summary[name] for entry in entries])
        colours = [entry.colour for entry in entries]
        bars = {"ecolor": INK, "capsize": 2, "error_kw": {"lw": 1}}
        panel.barh([entry.label for entry in entries], values, xerr=errors, color=colours, height=0.65, **bars)
        panel.set_title(heading(name))
        panel.grid(visible=False, axis="y")
    axes[0].invert_yaxis()
    return drawing
