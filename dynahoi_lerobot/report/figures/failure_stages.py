"""Failure stages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.style import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STAGES = {
    "missed": "#b2182b",
    "touched": "#ef8a62",
    "enclosed": "#f2c14e",
    "slipped": "#9e7bb5",
    "localized": "#67a9cf",
    "captured": "#1b7837",
    "held": "#1b7837",
}
"""The stages of both capture rules, from the earliest failure to success."""


@figure("stages", "Where episodes end", place=20)
def failure_stages(entries: Sequence[Entry]) -> Figure:
    """The share of episodes that ended in each stage.

    Under the capture rule attach: missed, localized, captured. Under contact: missed, touched, enclosed,
    slipped, held.
    """
    drawing, (panel,) = new_figure(1, 1, 0.9 + 0.32 * len(entries))
    shares = [_shares(entry) for entry in entries]
    present = [*STAGES, *sorted({stage for share in shares for stage in share} - set(STAGES))]
    left = np.zeros(len(entries))
    for stage in present:
        width = np.array([100 * share[stage] for share in shares])
        if width.any():
            _layer(panel, [entry.label for entry in entries], width, left, stage)
            left += width
    panel.set(xlim=(0, 100), xlabel="episodes [%]")
    panel.grid(visible=False, axis="y")
    panel.invert_yaxis()
    drawing.legend(loc="outside upper left", ncols=7)
    return drawing


def _shares(entry: Entry) -> Counter[str]:
    stages = Counter(row["stage"] for row in entry.results.rows)
    return Counter({stage: count / len(entry.results.rows) for stage, count in stages.items()})


def _layer(panel: Axes, labels: list[str], width: np.ndarray, left: np.ndarray, stage: str) -> None:
    bars = panel.barh(labels, width, left=left, height=0.65, color=STAGES.get(stage, "#808080"), label=stage)
    texts = [f"{share:.0f}" if share >= 4 else "" for share in width]
    panel.bar_label(bars, texts, label_type="center", color="white")
