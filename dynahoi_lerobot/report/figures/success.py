"""Success: overall, by stage, by stratum and frame by frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.evaluate.strata import STRATA
from dynahoi_lerobot.evaluate.table import heading
from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import ACROSS, columns_of, figure, scaled, stratified
from dynahoi_lerobot.report.style import INK, hide_unused, legend, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@figure("main", "Main metrics", place=10)
def main_metrics(entries: Sequence[Entry]) -> Figure:
    """The main metrics with 95 % intervals (Wilson for rates, bootstrap for means).

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


@figure("periodicity", "Success by periodicity", place=40)
def by_periodicity(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by periodicity (Figures "Periodicity-stratified performance" and "All periodicity-stratified").

    Circular arcs are circular; harmonic motions and pendulums are periodic; lines, projectiles, rolling and
    impacts are linear; hybrid motions mix these and stand alone.
    """
    return stratified(entries, "periodicity")


@figure("duration", "Success by duration", place=50)
def by_duration(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by the length of the recording [frames] (Figure "Length-stratified performance").

    The bins are those of Figure "Data statistics", c.
    """
    return stratified(entries, "duration")


@figure("travel", "Success by travel", place=60)
def by_travel(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by the straight distance from palm to intercept [u = 0.1 m].

    Figure "Length-stratified performance"; the bins are those of Figure "Data statistics", d.
    """
    return stratified(entries, "travel")


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
