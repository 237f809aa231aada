"""The report's figures: each is a function of the evaluations, and its docstring is its caption."""

from __future__ import annotations

import inspect
import io
import re
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, HAND_DOF, JOINT_NAMES, PALM_DOF
from dynahoi_lerobot.core.escaping import data_url
from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.evaluate.rows import Row
from dynahoi_lerobot.evaluate.summary import Estimate
from dynahoi_lerobot.evaluate.table import columns_for, heading
from dynahoi_lerobot.metrics.columns import STRATA
from dynahoi_lerobot.metrics.grasp import FINGERS_AT_LEAST
from dynahoi_lerobot.report.entries import COLORS, Entry, clip, distinct_episodes, short_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 12.0
"""Width of every figure [inch]: the width of the page's column."""
PANELS_PER_ROW = 5
LEGEND_COLUMNS = 4
INK = "#0a0b0c"
"""Placeholder for the text color while drawing; in the SVG the page's text color replaces it."""
INK_CSS = (
    "<style>:root{--ink:#1f2328}@media(prefers-color-scheme:dark){:root{--ink:#e6e8eb}}</style>"
)
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "dynahoi",
    "text.parse_math": False,  # a policy may be called $x
    "font.sans-serif": ["DejaVu Sans", "Verdana", "Arial"],
    **dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize"), 9),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False),
    **dict.fromkeys(("axes.axisbelow", "axes.grid"), True),
    **dict.fromkeys(("figure.facecolor", "axes.facecolor"), "none"),
    **dict.fromkeys(
        ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK
    ),
    "grid.color": INK,
    "grid.alpha": 0.15,
}
BARS: dict[str, Any] = {"ecolor": INK, "capsize": 2, "error_kw": {"lw": 1}}

Draw = Callable[[Sequence[Entry]], "Figure | None"]


FIGURES: dict[str, tuple[str, Draw]] = {}
"""Heading and drawing function by anchor, in the order of the page. A function returns None if
there is nothing to draw; its docstring is the caption."""


def figure(name: str, title: str) -> Callable[[Draw], Draw]:
    """Return a decorator that puts a drawing function on the page."""

    def decorate(draw: Draw) -> Draw:
        FIGURES[name] = (title, draw)
        return draw

    return decorate


def rendered(entries: Sequence[Entry]) -> list[dict[str, str]]:
    """Return ``name``, ``title``, ``caption`` and ``address`` of each figure that there is."""
    figures = []
    for name, (title, draw) in FIGURES.items():
        address = render(draw, entries)
        if address is not None:
            words = {"name": name, "title": title, "caption": caption(draw)}
            figures.append(words | {"address": address})
    return figures


def caption(draw: Draw) -> str:
    """Return the caption of a figure."""
    return " ".join(inspect.cleandoc(draw.__doc__ or "").replace("``", "").split())


def render(draw: Draw, entries: Sequence[Entry]) -> str | None:
    """Return a drawing as the ``data:`` address of an SVG in the report's style; None if there is
    none.

    It follows the page's light or dark scheme. As an image it is inert: nothing written in it can
    run or load anything.
    """
    import matplotlib.style

    buffer = io.StringIO()
    with matplotlib.style.context(STYLE, after_reset=True):
        drawing = draw(entries)
        if drawing is None:
            return None
        # nothing that changes between runs
        metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        drawing.savefig(buffer, format="svg", metadata=metadata)
    text = buffer.getvalue().replace(INK, "var(--ink)")
    svg = re.sub("<svg[^>]*>", rf"\g<0>{INK_CSS}", text, count=1)
    return data_url("image/svg+xml", svg.encode())


# -- what several figures share --------------------------------------------------------------------


def subplots(
    rows: int, columns: int, height_in: float, **options: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure of the page's width and its axes, row by row."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    return drawing, list(drawing.subplots(rows, columns, squeeze=False, **options).ravel())


def metric_panels(
    entries: Sequence[Entry], row_height_in: float, **options: Any
) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure with a titled panel for each of the main metrics, and the panels by
    metric.
    """
    names = columns_for([entry.results for entry in entries])
    rows = -(-len(names) // PANELS_PER_ROW)
    height_in = row_height_in * rows + 0.4 + legend_height_in(entries)
    drawing, axes = subplots(rows, min(PANELS_PER_ROW, len(names)), height_in, **options)
    for unused in axes[len(names) :]:
        unused.remove()
    panels = dict(zip(names, axes, strict=False))
    for name, panel in panels.items():
        panel.set_title(heading(name))
    return drawing, panels


def legend_height_in(entries: Sequence[Entry]) -> float:
    """Return the height [inch] of a legend's rows beyond the first."""
    return 0.2 * ((len(entries) - 1) // LEGEND_COLUMNS)


def legend(drawing: Figure, entries: Sequence[Entry], *, bars: bool = False) -> None:
    """Put labels with the marks of their lines or ``bars`` above the axes."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(label=entry.label, **bar_style(entry))
        if bars
        else Line2D([], [], label=entry.label, ms=4, **line_style(entry))
        for entry in entries
    ]
    columns = min(len(entries), LEGEND_COLUMNS)
    drawing.legend(handles=handles, loc="outside upper left", ncols=columns)


def line_style(entry: Entry) -> dict[str, Any]:
    """Return how matplotlib draws a line with points of an evaluation."""
    return {"color": entry.color, "linestyle": entry.dashes, "marker": entry.marker}


def bar_style(entry: Entry) -> dict[str, Any]:
    """Return how matplotlib draws a bar of an evaluation."""
    return {"facecolor": entry.color, "hatch": entry.hatch, "edgecolor": INK, "linewidth": 0}


def error_bars(estimates: Sequence[Estimate | None]) -> tuple[np.ndarray, np.ndarray]:
    """Return (K,) values and (2, K) lengths of their error bars, fractions in per cent; nan where
    there is none.
    """
    rows = [(estimate.shown() if estimate else []) or [np.nan] * 3 for estimate in estimates]
    value, low, high = np.array(rows).reshape(-1, 3).T
    return value, np.stack([value - low, high - value])


def points(panel: Axes, x: np.ndarray, estimates: Sequence[Estimate | None], entry: Entry) -> None:
    """Draw K estimates with their 95 % intervals at (K,) places ``x``, joined by a line."""
    values, errors = error_bars(estimates)
    panel.errorbar(x, values, errors, ms=4, lw=1.2, capsize=2, **line_style(entry))


def stratified(entries: Sequence[Entry], stratum: str) -> Figure | None:
    """Draw every metric over the labels of ``stratum``; None with fewer than two labels."""
    labels = STRATA[stratum].arrange(
        {row[stratum] for entry in entries for row in entry.results.rows}
    )
    if len(labels) < 2:
        return None
    drawing, panels = metric_panels(entries, 2.0)
    legend(drawing, entries)
    for name, panel in panels.items():
        for place, entry in enumerate(entries):
            shift = 0.12 * (place - (len(entries) - 1) / 2) / max(1, len(entries) / 4)
            groups = entry.results.by(stratum)
            estimates = [groups[label][name] if label in groups else None for label in labels]
            points(panel, np.arange(len(labels)) + shift, estimates, entry)
        panel.set_xticks(range(len(labels)), labels, fontsize=8)
        panel.set_xlim(-0.5, len(labels) - 0.5)
    return drawing


# -- success ---------------------------------------------------------------------------------------


@figure("main", "Main metrics")
def main_metrics(entries: Sequence[Entry]) -> Figure:
    """The main metrics with 95 % intervals (Wilson for rates, bootstrap for means).

    An arrow in a title points towards better.
    """
    drawing, panels = metric_panels(entries, 0.8 + 0.26 * len(entries), sharey=True)
    for name, panel in panels.items():
        for entry in entries:
            value, error = error_bars([entry.results.summary[name]])
            style = bar_style(entry)
            panel.barh([entry.label], value, xerr=error, height=0.65, **style, **BARS)
        panel.grid(visible=False, axis="y")
    next(iter(panels.values())).invert_yaxis()
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
"""Color of each stage of both capture rules, from the earliest failure to success."""


@figure("stages", "Where episodes end")
def failure_stages(entries: Sequence[Entry]) -> Figure:
    """The share of episodes that ended in each stage.

    Under the capture rule attach: missed, localized, captured. Under contact: missed, touched,
    enclosed, slipped, held.
    """
    drawing, (panel,) = subplots(1, 1, 0.9 + 0.32 * len(entries))
    counts = [Counter(row["stage"] for row in entry.results.rows) for entry in entries]
    labels = [entry.label for entry in entries]
    left = np.zeros(len(entries))
    for stage in [*STAGES, *sorted({stage for count in counts for stage in count} - set(STAGES))]:
        width = np.array([100 * count[stage] / count.total() for count in counts])
        if width.any():
            bars = panel.barh(
                labels,
                width,
                left=left,
                height=0.65,
                color=STAGES.get(stage, "#808080"),
                label=stage,
            )
            texts = [f"{share:.0f}" if share >= 4 else "" for share in width]
            panel.bar_label(bars, texts, label_type="center", color="white")
            left += width
    panel.set(xlim=(0, 100), xlabel="episodes [%]")
    panel.grid(visible=False, axis="y")
    panel.invert_yaxis()
    drawing.legend(loc="outside upper left", ncols=7)
    return drawing


@figure("per-kind", "Success by kind of motion")
def per_kind(entries: Sequence[Entry]) -> Figure | None:
    """S_loc [%] for every kind, kinds of one category side by side, with the number of episodes.

    Under the capture rule contact a second map shows S_hold. An empty cell was not played.
    """
    category_of = {row["kind"]: row["category"] for entry in entries for row in entry.results.rows}
    categories = STRATA["category"].arrange(set(category_of.values()))
    kinds = sorted(category_of, key=lambda kind: (categories.index(category_of[kind]), kind))
    if len(kinds) < 2:
        return None
    contact = [entry for entry in entries if entry.results.info.capture == "contact"]
    maps = {"S_loc": entries, "S_hold": contact} if contact else {"S_loc": entries}
    heights = [0.44 * len(shown) + 0.2 for shown in maps.values()]
    drawing, axes = subplots(len(maps), 1, sum(heights) + 1.7, sharex=True, height_ratios=heights)
    for panel, (name, shown) in zip(axes, maps.items(), strict=True):
        summaries = [entry.results.by("kind") for entry in shown]
        cells = [
            [by_kind[kind][name] if kind in by_kind else None for kind in kinds]
            for by_kind in summaries
        ]
        _heat_map(panel, cells, name)
        panel.set_yticks(range(len(shown)), [entry.label for entry in shown])
        panel.set_xticks(range(len(kinds)), kinds, rotation=45, ha="right", rotation_mode="anchor")
        for place, (kind, other) in enumerate(pairwise(kinds)):
            if category_of[kind] != category_of[other]:
                panel.axvline(place + 0.5, color="#808080", lw=1)
    return drawing


def _heat_map(panel: Axes, cells: Sequence[Sequence[Estimate | None]], name: str) -> None:
    """Draw estimates of (evaluations, kinds) as colored cells with value [%] and n; one without
    episodes is empty.
    """
    grid = np.stack([error_bars(row)[0] for row in cells])
    panel.imshow(grid, cmap="viridis", vmin=0, vmax=100, aspect="auto")
    for (row, column), value in np.ndenumerate(grid):
        estimate = cells[row][column]
        if estimate is not None and estimate.n:
            style: dict[str, Any] = {"color": "black" if value > 60 else "white", "ha": "center"}
            panel.text(column, row, f"{value:.0f}", va="bottom", fontsize=8, **style)
            panel.text(column, row + 0.05, f"n={estimate.n}", va="top", fontsize=6, **style)
    panel.set_title(f"{name} [%]", loc="left")
    panel.grid(visible=False)


@figure("periodicity", "Success by periodicity")
def by_periodicity(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by periodicity.

    Circular arcs are circular; harmonic motions and pendulums are periodic; lines, projectiles,
    rolling and impacts are linear; hybrid motions mix these and stand alone.
    """
    return stratified(entries, "periodicity")


@figure("duration", "Success by duration")
def by_duration(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by the length of the recording [frames]."""
    return stratified(entries, "duration")


@figure("travel", "Success by travel")
def by_travel(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by the straight distance from palm to intercept [u = 0.1 m]."""
    return stratified(entries, "travel")


@figure("time-to-catch", "Time to the catch")
def time_to_catch(entries: Sequence[Entry]) -> Figure:
    """The share of episodes in which the target has been localized by a time after the control
    start [s].
    """
    drawing, (panel,) = subplots(1, 1, 3.0 + legend_height_in(entries))
    for entry in entries:
        rows = entry.results.rows
        hits = [row for row in rows if row["first_localized"] is not None]
        waits = [(row["first_localized"] - row["window_frames"]) * CONTROL_DT for row in hits]
        share = 100 * np.arange(len(waits) + 1) / len(rows)
        longest = max(row["length_frames"] for row in rows) * CONTROL_DT
        times = [0, *sorted(waits), longest]
        shares = [*share, share[-1]]
        style = line_style(entry) | {"markevery": 0.1, "ms": 4}
        panel.step(times, shares, where="post", **style)
    panel.set(xlabel="time since the control start [s]", ylabel="localized [%]", ylim=(0, 100))
    legend(drawing, entries)
    return drawing


@figure("per-frame-grasp", "Grasp, frame by frame")
def per_frame_grasp(entries: Sequence[Entry]) -> Figure | None:
    """The share of control frames in which at least 3, 4 or 5 fingers are at the reference grasp.

    The hand should be open as it approaches, so 100 % is not the aim. Under the capture rule
    contact the target stops the fingers earlier, so it is not shown.
    """
    names = [f"grasp_{setting}" for setting in FINGERS_AT_LEAST]
    shown = [entry for entry in entries if entry.results.summary[names[0]].n]
    if not shown:
        return None
    drawing, (panel,) = subplots(1, 1, 3.0 + legend_height_in(shown))
    width = 0.8 / len(shown)
    for place, entry in enumerate(shown):
        values, errors = error_bars([entry.results.summary[name] for name in names])
        x = np.arange(len(values)) + (place - (len(shown) - 1) / 2) * width
        panel.bar(x, values, 0.9 * width, yerr=errors, **bar_style(entry), **BARS)
    panel.set_xticks(
        range(3), [f"{setting}\n≥ {n} fingers" for setting, n in FINGERS_AT_LEAST.items()]
    )
    panel.set_ylabel("frames [%]")
    panel.grid(visible=False, axis="x")
    legend(drawing, shown, bars=True)
    return drawing


# -- metrics by latency ----------------------------------------------------------------------------


def latency_ms(entry: Entry) -> float | None:
    """Return the declared latency of an evaluation [ms]; None if it was measured, or its label does
    not state it.
    """
    label = entry.results.info.extra.get("inference")
    if not label:
        return 0.0
    match = re.fullmatch(r"\w+ ([\d.e+]+) ms", label)  # as `Inference.label` says it
    return float(match[1]) if match else None


@figure("latency", "Inference latency")
def latency(entries: Sequence[Entry]) -> Figure | None:
    """The metrics by inference latency, one line for each policy under each set of rules.

    Drawn from evaluations under ``--inference async`` or ``rtc`` with a declared latency; 0 where
    the world waits.
    """
    told = {entry: latency_ms(entry) for entry in entries}
    latencies = {entry: ms for entry, ms in told.items() if ms is not None}
    if len(set(latencies.values())) < 2:
        return None
    lines: dict[str, list[Entry]] = {}
    for entry in sorted(latencies, key=latencies.__getitem__):
        info = entry.results.info
        control_class = entry.results.conditions["control_class"]
        rules = (short_name(info.policy), info.split, info.capture, control_class)
        lines.setdefault(", ".join(rules), []).append(entry)
    titles = [
        Entry.of(line[0].results, clip(label), place)
        for place, (label, line) in enumerate(lines.items())
    ]
    drawing, panels = metric_panels([*latencies], 2.0)
    legend(drawing, titles)
    for name, panel in panels.items():
        for title, line in zip(titles, lines.values(), strict=True):
            places = np.array([latencies[entry] for entry in line])
            points(panel, places, [entry.results.summary[name] for entry in line], title)
        panel.set_xlabel("latency of an inference [ms]")
    return drawing


# -- the episodes ----------------------------------------------------------------------------------

PAPER_DURATION = {"20-40": 20.2, "40-60": 36.1, "60-80": 19.5, "80-120": 13.9, ">120": 10.1}
PAPER_TRAVEL = {"0-0.5": 20.1, "0.5-2": 47.7, "2-4": 16.4, ">4": 5.8}
"""Shares [%] that the paper's Section "Diversity Analysis" gives; its travels add up to 90 %."""


@figure("data", "The episodes")
def data_statistics(entries: Sequence[Entry]) -> Figure:
    """The durations and travels of the distinct episodes of all evaluations.

    A diamond marks the share that the paper's text reports for its own data.
    """
    rows = distinct_episodes(entries)
    drawing, (durations, travels) = subplots(1, 2, 3.0)
    _share_bars(durations, rows, "duration", PAPER_DURATION)
    _share_bars(travels, rows, "travel", PAPER_TRAVEL)
    durations.set(xlabel="recording [frames]", ylabel="episodes [%]")
    travels.set(xlabel="straight distance to the intercept [u]")
    return drawing


def _share_bars(panel: Axes, rows: Sequence[Row], stratum: str, paper: dict[str, float]) -> None:
    """Draw the share of episodes with each label of ``stratum`` [%], and ``paper``'s shares [%] as
    diamonds.
    """
    counts = Counter(row[stratum] for row in rows)
    labels = [label for label in STRATA[stratum].order if counts[label] or label in paper]
    panel.bar(
        labels, [100 * counts[label] / len(rows) for label in labels], color=COLORS[0], width=0.7
    )
    panel.plot(list(paper), list(paper.values()), "D", color=COLORS[5], ms=5, label="paper")
    panel.grid(visible=False, axis="x")
    panel.legend()


HISTOGRAM_BINS = 41


def command_deltas(results: Results) -> np.ndarray:
    """Return (K, 18) changes between successive commands of the control phase: palm [m], joints
    [rad].
    """
    changes = [
        np.diff(actions[row["window_frames"] :], axis=0)
        for row, actions in zip(results.rows, results.actions, strict=True)
    ]
    return np.concatenate([np.zeros((0, HAND_DOF), np.float32), *changes])


def overlay(panel: Axes, samples: Sequence[np.ndarray], entries: Sequence[Entry]) -> None:
    """Draw a histogram of every entry's (K,) samples, in shares of its frames [%], over bins common
    to all entries.
    """
    reach = (
        max((float(np.abs(sample).max()) for sample in samples if sample.size), default=0.0) or 1.0
    )
    edges = np.linspace(-reach, reach, HISTOGRAM_BINS + 1)
    for sample, entry in zip(samples, entries, strict=True):
        share = 100 * np.histogram(sample, edges)[0] / max(1, sample.size)
        panel.stairs(share, edges, color=entry.color, linestyle=entry.dashes, lw=1.2)
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter("{x:g}")
    panel.minorticks_off()


@figure("joint-deltas", "Joint rotations")
def joint_deltas(entries: Sequence[Entry]) -> Figure:
    """Frame-to-frame change of the 15 commanded joint angles [deg], control phase, share of frames
    [%].
    """
    drawing, axes = subplots(3, 5, 5.4 + legend_height_in(entries), sharex=True, sharey=True)
    # (K, 15) [deg] of each entry
    deltas = [np.rad2deg(command_deltas(entry.results)[:, PALM_DOF:]) for entry in entries]
    for joint, name in enumerate(JOINT_NAMES):
        finger, part = divmod(joint, 3)
        panel = axes[5 * part + finger]
        overlay(panel, [values[:, joint] for values in deltas], entries)
        panel.set_title(name.replace("_", " "))
    for panel in axes[10:]:
        panel.set_xlabel("change [deg]")
    legend(drawing, entries)
    return drawing


@figure("palm-displacements", "Palm displacements")
def palm_displacements(entries: Sequence[Entry]) -> Figure:
    """Frame-to-frame change of the commanded palm position [mm] along x, y and z, control phase,
    share of frames [%].
    """
    drawing, axes = subplots(1, 3, 2.6 + legend_height_in(entries), sharey=True)
    # (K, 3) [mm] of each entry
    deltas = [1000 * command_deltas(entry.results)[:, :PALM_DOF] for entry in entries]
    for axis, panel in enumerate(axes):
        overlay(panel, [values[:, axis] for values in deltas], entries)
        panel.set_xlabel(f"change along {'xyz'[axis]} [mm]")
    legend(drawing, entries)
    return drawing
