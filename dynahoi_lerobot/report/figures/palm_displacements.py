"""Distribution of palm displacements per frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynahoi_lerobot.foundation.conventions import PALM_DOF
from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.histograms import command_deltas, overlay
from dynahoi_lerobot.report.style import legend, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@figure("palm-displacements", "Palm displacements", place=120)
def palm_displacements(entries: Sequence[Entry]) -> Figure:
    """Frame-to-frame change of the commanded palm position [mm] along x, y and z, control phase, share of frames [%].

    Figure "Distribution of 3D Cartesian displacements".
    """
    drawing, axes = new_figure(1, 3, 2.6, sharey=True)
    deltas = [1000 * command_deltas(entry.results)[:, :PALM_DOF] for entry in entries]  # (K, 3) [mm]
    for axis, panel in enumerate(axes):
        overlay(panel, [values[:, axis] for values in deltas], entries)
        panel.set_xlabel(f"change along {'xyz'[axis]} [mm]")
    legend(drawing, entries)
    return drawing
