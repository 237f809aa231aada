"""Success by motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.evaluate.strata import STRATA
from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.style import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@figure("per-kind", "Success by kind of motion", place=30)
def per_kind(entries: Sequence[Entry]) -> Figure | None:
    """S_loc [%] for every kind, kinds of one category side by side.

    Under the capture rule contact a second map shows S_hold. An empty cell was not played.
    """
    kinds, separators = _ordered_kinds(entries)
    if len(kinds) < 2:
        return None
    maps = {"S_loc": entries, "S_hold": [e for e in entries if e.results.info.capture == "contact"]}
    maps = {name: shown for name, shown in maps.items() if shown}
    heights = [0.36 * len(shown) + 0.2 for shown in maps.values()]
    drawing, axes = new_figure(len(maps), 1, sum(heights) + 1.7, sharex=True, height_ratios=heights)
    for panel, (name, shown) in zip(axes, maps.items(), strict=True):
        _heat(panel, _grid(shown, kinds, name), name)
        panel.set_yticks(range(len(shown)), [entry.label for entry in shown])
        panel.set_xticks(range(len(kinds)), kinds, rotation=45, ha="right", rotation_mode="anchor")
        for separator in separators:
            panel.axvline(separator - 0.5, color="#808080", lw=1)
    return drawing


def _ordered_kinds(entries: Sequence[Entry]) -> tuple[list[str], list[int]]:
    """Return the kinds, category by category, and the places where a new category begins."""
    pairs = {(row["category"], row["kind"]) for entry in entries for row in entry.results.rows}
    categories = STRATA["category"].arrange({category for category, _ in pairs})
    groups = [sorted(kind for category, kind in pairs if category == wanted) for wanted in categories]
    starts = np.cumsum([len(group) for group in groups])[:-1]
    return [kind for group in groups for kind in group], starts.tolist()


def _grid(entries: Sequence[Entry], kinds: Sequence[str], name: str) -> np.ndarray:
    """Return (entries, kinds) values [%], nan where nothing was played."""
    grid = np.full((len(entries), len(kinds)), np.nan)
    for row, entry in enumerate(entries):
        for column, kind in enumerate(kinds):
            value = entry.by("kind")[kind][name].value if kind in entry.by("kind") else None
            grid[row, column] = np.nan if value is None else 100 * value
    return grid


def _heat(panel: Axes, grid: np.ndarray, name: str) -> None:
    panel.imshow(grid, cmap="viridis", vmin=0, vmax=100, aspect="auto")
    for (row, column), value in np.ndenumerate(grid):
        if not np.isnan(value):
            colour = "black" if value > 60 else "white"
            panel.text(column, row, f"{value:.0f}", ha="center", va="center", color=colour, fontsize=8)
    panel.set_title(f"{name} [%]", loc="left")
    panel.grid(visible=False)
