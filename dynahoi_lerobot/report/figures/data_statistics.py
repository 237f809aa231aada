"""Statistics of the evaluated episodes: hierarchy of motions, durations and travels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.evaluate.episode_row import Row
from dynahoi_lerobot.evaluate.strata import STRATA
from dynahoi_lerobot.report.entries import Entry, distinct_episodes
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.style import INK, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Wedge

PAPER_DURATION = {"20-40": 20.2, "40-60": 36.1, "60-80": 19.5, "80-120": 13.9, ">120": 10.1}
PAPER_TRAVEL = {"0-0.5": 20.1, "0.5-2": 47.7, "2-4": 16.4, ">4": 5.8}
"""Shares [%] that the paper's Section "Diversity Analysis" gives; its travels add up to 90 %."""

TIER_MAPS = {"kinematic": "Blues", "physical": "Oranges", "stochastic": "Greens"}


@figure("data", "The episodes", place=100)
def data_statistics(entries: Sequence[Entry]) -> Figure:
    """The distinct episodes of all evaluations: tier, category and kind from the inside out; durations; travels.

    Figure "Data statistics" a, c and d; a diamond marks the share that the paper's text reports for its own
    data.
    """
    rows = distinct_episodes(entries)
    drawing, (rings, durations, travels) = new_figure(1, 3, 5.0, width_ratios=[1.7, 1, 1])
    _sunburst(rings, rows)
    _shares(durations, rows, "duration", PAPER_DURATION)
    _shares(travels, rows, "travel", PAPER_TRAVEL)
    durations.set(xlabel="recording [frames]", ylabel="episodes [%]")
    travels.set(xlabel="straight distance to the intercept [u]")
    return drawing


def _sunburst(panel: Axes, rows: Sequence[Row]) -> None:
    """Draw three rings whose wedges are the episodes of a tier, a category and a kind."""
    counts = Counter((row["tier"], row["category"], row["kind"]) for row in rows)
    leaves = sorted(counts, key=_rank)
    for depth, radius in ((1, 0.8), (2, 1.5), (3, 1.75)):
        names = list(dict.fromkeys(leaf[:depth] for leaf in leaves))
        sizes = [sum(counts[leaf] for leaf in leaves if leaf[:depth] == name) for name in names]
        colours = [_shade(name, leaves, depth) for name in names]
        wedges, _ = panel.pie(
            sizes, radius=radius, colors=colours, startangle=90, counterclock=False,
            wedgeprops={"width": 0.25 if depth == 3 else 0.7, "edgecolor": "white", "linewidth": 0.6},
        )  # fmt: skip
        for wedge, name, size in zip(wedges, names, sizes, strict=True):
            if size >= 0.02 * len(rows):
                _write(
                    panel, wedge, name[-1] if depth == 3 else name[-1].replace("_", "\n"), radius, outside=depth == 3
                )
    panel.set(xlim=(-2.7, 2.7), ylim=(-2.4, 2.4))


def _rank(leaf: tuple[str, str, str]) -> tuple[int, int, str]:
    return _place(leaf[0], STRATA["tier"].order), _place(leaf[1], STRATA["category"].order), leaf[2]


def _place(name: str, order: Sequence[str]) -> int:
    return order.index(name) if name in order else len(order)


def _shade(name: tuple[str, ...], leaves: Sequence[tuple[str, str, str]], depth: int) -> tuple:
    import matplotlib as mpl

    siblings: list[tuple[str, ...]] = list(dict.fromkeys(leaf[:2] for leaf in leaves if leaf[0] == name[0]))
    step = siblings.index(name[:2]) / max(1, len(siblings) - 1) if depth > 1 else 0.5
    return mpl.colormaps[TIER_MAPS.get(name[0], "Greys")](0.75 - 0.12 * (depth - 1) - 0.2 * step)


def _write(panel: Axes, wedge: Wedge, text: str, radius: float, *, outside: bool) -> None:
    middle = np.deg2rad((wedge.theta1 + wedge.theta2) / 2)
    distance = radius + 0.05 if outside else radius - 0.33
    x, y = distance * np.cos(middle), distance * np.sin(middle)
    turn = np.rad2deg(middle) % 360
    upright = turn - 180 if 90 < turn < 270 else turn
    side = ("left" if x > 0 else "right") if outside else "center"
    style = {"color": INK, "fontsize": 7} if outside else {"color": "black", "fontsize": 6}
    panel.text(x, y, text, ha=side, va="center", rotation=upright, rotation_mode="anchor", **style)


def _shares(panel: Axes, rows: Sequence[Row], stratum: str, paper: dict[str, float]) -> None:
    counts = Counter(row[stratum] for row in rows)
    labels = [label for label in STRATA[stratum].order if counts[label] or label in paper]
    panel.bar(labels, [100 * counts[label] / len(rows) for label in labels], color="#0072b2", width=0.7)
    panel.plot(list(paper), list(paper.values()), "D", color="#d55e00", ms=5, label="paper")
    panel.grid(visible=False, axis="x")
    panel.legend()
