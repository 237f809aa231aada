"""Success by periodicity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.panels import stratified

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@figure("periodicity", "Success by periodicity", place=40)
def by_periodicity(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by periodicity (Figures "Periodicity-stratified performance" and "All periodicity-stratified").

    Circular arcs are circular; harmonic motions and pendulums are periodic; lines, projectiles, rolling and
    impacts are linear; hybrid motions mix these and stand alone.
    """
    return stratified(entries, "periodicity")
