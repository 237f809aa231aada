"""Success by duration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.panels import stratified

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@figure("duration", "Success by duration", place=50)
def by_duration(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by the length of the recording [frames] (Figure "Length-stratified performance").

    The bins are those of Figure "Data statistics", c.
    """
    return stratified(entries, "duration")
