"""The interface of a figure, and the panels that several figures share."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.evaluate.strata import STRATA
from dynahoi_lerobot.evaluate.summary import Estimate, Summary
from dynahoi_lerobot.evaluate.table import columns_for, heading
from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.style import Labelled, figure_style, hide_unused, legend, new_figure, svg_data_uri

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Draw = Callable[[Sequence[Entry]], "Figure | None"]


@dataclass(frozen=True)
class ReportFigure:
    """One figure of the report.

    Attributes:
        name: the anchor on the page.
        title: the heading on the page.
        place: figures appear in the order of this number.
        draw: returns the drawing, or None if there is nothing to draw; its docstring is the caption.
    """

    name: str
    title: str
    place: int
    draw: Draw

    @property
    def caption(self) -> str:
        """Caption: what the figure shows, and its counterpart in the paper."""
        return " ".join(inspect.cleandoc(self.draw.__doc__ or "").replace("``", "").split())

    def render(self, entries: Sequence[Entry]) -> str | None:
        """Return the drawing as a ``data:`` address, or None."""
        with figure_style():
            drawing = self.draw(entries)
            return None if drawing is None else svg_data_uri(drawing)


FIGURES: Registry[ReportFigure] = Registry("figure", "dynahoi_lerobot.report.figures")


def figure(name: str, title: str, place: int) -> Callable[[Draw], ReportFigure]:
    """Return a decorator that turns a drawing function into the registered figure ``name``."""

    def decorate(draw: Draw) -> ReportFigure:
        return FIGURES.register(name)(ReportFigure(name, title, place, draw))

    return decorate


def in_order() -> list[ReportFigure]:
    """Return every registered figure in the order of the page."""
    return sorted((entry for _, entry in FIGURES.items()), key=lambda entry: (entry.place, entry.name))


ACROSS = 4
"""Panels in a row."""


def columns_of(entries: Sequence[Entry]) -> tuple[str, ...]:
    """Return the main metrics, preceded by S_hold if any evaluation uses the capture rule contact."""
    return columns_for([entry.results for entry in entries])


def scaled(estimates: Sequence[Estimate]) -> tuple[np.ndarray, np.ndarray]:
    """Return (K,) values and (2, K) distances to the interval's ends as printed: fractions in per cent, None as nan."""
    rows = [(e.value, e.low, e.high) if e.value is not None else (np.nan,) * 3 for e in estimates]
    scales = np.array([100 if e.unit == "fraction" else 1 for e in estimates])  # an empty group has no unit
    value, low, high = np.array(rows, np.float64).reshape(-1, 3).T * scales
    return value, np.stack([value - low, high - value])


def metric_panels(names: Sequence[str], shown: Sequence[Labelled]) -> tuple[Figure, list[Axes]]:
    """Return a figure with a titled panel for each metric and a legend of what it shows."""
    rows = -(-len(names) // ACROSS)
    figure, axes = new_figure(rows, min(ACROSS, len(names)), 2.2 * rows + 0.4)
    hide_unused(axes, len(names))
    for panel, name in zip(axes, names, strict=False):
        panel.set_title(heading(name))
    legend(figure, shown)
    return figure, axes


def stratified(entries: Sequence[Entry], stratum: str) -> Figure | None:
    """Draw every metric over the labels of ``stratum`` with 95 % intervals; None with fewer than two labels."""
    labels = STRATA[stratum].arrange({row[stratum] for entry in entries for row in entry.results.rows})
    if len(labels) < 2:
        return None
    figure, axes = metric_panels(columns_of(entries), entries)
    for panel, name in zip(axes, columns_of(entries), strict=False):
        for place, entry in enumerate(entries):
            shift = 0.12 * (place - (len(entries) - 1) / 2) / max(1, len(entries) / 4)
            estimates = [_pick(entry.by(stratum), label, name) for label in labels]
            draw_points(panel, np.arange(len(labels)) + shift, estimates, entry.colour)
        panel.set_xticks(range(len(labels)), labels)
        panel.set_xlim(-0.5, len(labels) - 0.5)
    return figure


def draw_points(panel: Axes, x: np.ndarray, estimates: Sequence[Estimate], colour: str) -> None:
    """Draw estimates over (K,) numbers with their 95 % intervals, joined by a line."""
    values, errors = scaled(estimates)
    line = "-" if len(x) > 1 else "none"
    panel.errorbar(x, values, errors, fmt="o", ms=4, lw=1.2, linestyle=line, capsize=2, color=colour)


def _pick(groups: dict[str, Summary], label: str, name: str) -> Estimate:
    missing = Estimate(None, None, None, "score", 0)
    return groups[label][name] if label in groups else missing
