"""Success by travel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.panels import stratified

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@figure("travel", "Success by travel", place=60)
def by_travel(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by the straight distance from palm to intercept [u = 0.1 m].

    Figure "Length-stratified performance"; the bins are those of Figure "Data statistics", d.
    """
    return stratified(entries, "travel")
