"""The episodes: kinds, durations, travels, grasps and changes of command."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.core.conventions import HAND_DOF, JOINT_NAMES, PALM_DOF
from dynahoi_lerobot.evaluate.episode_row import Row
from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.evaluate.strata import STRATA
from dynahoi_lerobot.report.entries import Entry, distinct_episodes
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.style import INK, legend, new_figure

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


COLOURS = "tab20"


@figure("grasp-magnitude", "Grasp and travel", place=105)
def grasp_magnitude(entries: Sequence[Entry]) -> Figure:
    """How far the reference grasp closes the hand [rad, mean of 15 joints] and how far the hand travels, per episode.

    Figure "Data statistics" b: small objects need large grasps, and each object is caught from near and far. Objects
    are listed from the largest grasp to the smallest.
    """
    import matplotlib as mpl

    objects = by_object(distinct_episodes(entries))
    drawing, (panel,) = new_figure(1, 1, 4.2)
    for place, (name, points) in enumerate(objects.items()):
        panel.scatter(*points.T, s=14, color=mpl.colormaps[COLOURS](place % 20), label=name, edgecolors="none")
    panel.set(xlabel="straight distance to the intercept [u]", ylabel="grasp [rad]")
    drawing.legend(loc="outside right upper")
    return drawing


def by_object(rows: Sequence[Row]) -> dict[str, np.ndarray]:
    """Return (K, 2) travel [u] and grasp [rad] of each object's episodes, the largest mean grasp first."""
    points = {
        name: np.array([[row["travel_u"], row["grasp_rad"]] for row in rows if row["object"] == name])
        for name in sorted({row["object"] for row in rows})
    }
    return dict(sorted(points.items(), key=lambda item: -item[1][:, 1].mean()))


BINS = 41


def command_deltas(results: Results) -> np.ndarray:
    """Return (K, 18) changes between successive commands of the control phase: palm [m], joints [rad]."""
    changes = [
        np.diff(actions[row["window_frames"] :], axis=0)
        for row, actions in zip(results.rows, results.actions, strict=True)
    ]
    return np.concatenate([np.zeros((0, HAND_DOF), np.float32), *changes])


def overlay(panel: Axes, samples: Sequence[np.ndarray], entries: Sequence[Entry]) -> None:
    """Draw the (K,) samples of every entry over common bins that hold all of them, as shares of its frames [%]."""
    reach = max((float(np.abs(sample).max()) for sample in samples if sample.size), default=0.0) or 1.0
    edges = np.linspace(-reach, reach, BINS + 1)
    for sample, entry in zip(samples, entries, strict=True):
        counts, _ = np.histogram(sample, edges)
        share = 100 * counts / max(1, sample.size)
        panel.stairs(share, edges, color=entry.colour, lw=1.2)
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter("{x:g}")
    panel.minorticks_off()


@figure("joint-deltas", "Joint rotations", place=110)
def joint_deltas(entries: Sequence[Entry]) -> Figure:
    """Frame-to-frame change of the 15 commanded joint angles [deg], control phase, share of frames [%].

    Figure "Distribution of 15-DoF joint rotation deltas".
    """
    drawing, axes = new_figure(3, 5, 5.4, sharex=True, sharey=True)
    deltas = [np.rad2deg(command_deltas(entry.results)[:, PALM_DOF:]) for entry in entries]  # (K, 15) [deg]
    for joint, name in enumerate(JOINT_NAMES):
        finger, part = divmod(joint, 3)
        panel = axes[5 * part + finger]
        overlay(panel, [values[:, joint] for values in deltas], entries)
        panel.set_title(name.replace("_", " "))
    for panel in axes[10:]:
        panel.set_xlabel("change [deg]")
    legend(drawing, entries)
    return drawing


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
