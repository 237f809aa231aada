"""Small multiples that several figures share: one panel per metric, one colour per evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.evaluate.strata import STRATA
from dynahoi_lerobot.evaluate.summary import Estimate, Summary
from dynahoi_lerobot.evaluate.table import columns_for, heading
from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.style import hide_unused, legend, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ACROSS = 4
"""Panels in a row."""

LARGEST_ON_AXIS = 1e12


def columns_of(entries: Sequence[Entry]) -> tuple[str, ...]:
    """Return the paper's metrics, led by S_hold if any evaluation uses the capture rule contact."""
    return columns_for([entry.results for entry in entries])


def scaled(estimates: Sequence[Estimate]) -> tuple[np.ndarray, np.ndarray]:
    """Return (K,) values and (2, K) distances to the interval's ends as printed: fractions in per cent, None as nan."""
    rows = [(e.value, e.low, e.high) if e.value is not None else (np.nan,) * 3 for e in estimates]
    scales = np.array([100 if e.unit == "fraction" else 1 for e in estimates])  # an empty group has no unit
    value, low, high = np.array(rows, np.float64).reshape(-1, 3).T * scales
    return value, np.stack([value - low, high - value])


def metric_panels(names: Sequence[str], entries: Sequence[Entry]) -> tuple[Figure, list[Axes]]:
    """Return a figure with a titled panel for each metric and a legend of the entries."""
    rows = -(-len(names) // ACROSS)
    figure, axes = new_figure(rows, min(ACROSS, len(names)), 2.2 * rows + 0.4)
    hide_unused(axes, len(names))
    for panel, name in zip(axes, names, strict=False):
        panel.set_title(heading(name))
    legend(figure, entries)
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
            _points(panel, np.arange(len(labels)) + shift, estimates, entry)
        panel.set_xticks(range(len(labels)), labels)
        panel.set_xlim(-0.5, len(labels) - 0.5)
    return figure


def curves(entries: Sequence[Entry], key: str, axis_label: str) -> Figure | None:
    """Draw every metric over the number ``extra[key]`` of each entry; None with fewer than two numbers."""
    known = sorted((e for e in entries if _is_number(e.results.info.extra.get(key))), key=lambda e: _extra(e, key))
    if len({_extra(entry, key) for entry in known}) < 2:
        return None
    names = columns_of(known)
    figure, axes = metric_panels(names, known)
    for panel, name in zip(axes, names, strict=False):
        for entry in known:
            _points(panel, np.array([_extra(entry, key)]), [entry.summary[name]], entry)
        for group in _same_run(known):
            values, _ = scaled([entry.summary[name] for entry in group])
            panel.plot([_extra(entry, key) for entry in group], values, color="#808080", lw=1, zorder=1)
        panel.set_xlabel(axis_label)
    return figure


def _points(panel: Axes, x: np.ndarray, estimates: Sequence[Estimate], entry: Entry) -> None:
    values, errors = scaled(estimates)
    line = "-" if len(x) > 1 else "none"
    panel.errorbar(x, values, errors, fmt="o", ms=4, lw=1.2, linestyle=line, capsize=2, color=entry.colour)


def _pick(groups: dict[str, Summary], label: str, name: str) -> Estimate:
    missing = Estimate(None, None, None, "score", 0)
    return groups[label][name] if label in groups else missing


def _same_run(entries: Sequence[Entry]) -> list[list[Entry]]:
    """Return the entries joined by a line: those of one split and capture rule."""
    groups: dict[tuple[str, str], list[Entry]] = {}
    for entry in entries:
        groups.setdefault((entry.results.info.split, entry.results.info.capture), []).append(entry)
    return list(groups.values())


def _extra(entry: Entry, key: str) -> float:
    return float(entry.results.info.extra[key])


def _is_number(value: object) -> bool:
    """Tell whether ``value`` is a number that an axis can show; JSON knows greater ones."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST_ON_AXIS
