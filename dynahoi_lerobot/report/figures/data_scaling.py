"""Scaling with the amount of training data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.curves import curves, stored

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@figure("data-scaling", "Training data", place=90)
def data_scaling(entries: Sequence[Entry]) -> Figure | None:
    """The metrics over the share of the training data (Figure "Training-data scaling").

    Drawn from evaluations that say ``data_fraction``.
    """
    return curves(entries, stored("data_fraction"), "share of the training data")
