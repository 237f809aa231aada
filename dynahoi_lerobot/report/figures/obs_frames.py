"""Ablation over the number of observed frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.curves import curves, stored

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@figure("obs-frames", "Observed frames", place=80)
def obs_frames(entries: Sequence[Entry]) -> Figure | None:
    """The metrics over the number of observed frames s (Figure "Obs-frames ablation").

    Drawn from evaluations that say ``n_obs_frames``, a line for each ``condition`` of a study.
    """
    return curves(entries, stored("n_obs_frames"), "observed frames s")
