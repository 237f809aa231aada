"""Metrics over a number that says how a policy was trained, a line for each way in which it was evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.report.entries import COLOURS, Entry, clip
from dynahoi_lerobot.report.figures.panels import columns_of, draw_points, metric_panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LARGEST_ON_AXIS = 1e12


@dataclass(frozen=True)
class Curve:
    """Evaluations under the same condition.

    Attributes:
        label: of the condition.
        colour: hexadecimal RGB.
        entries: in the order of their numbers.
    """

    label: str
    colour: str
    entries: Sequence[Entry]


def curves(entries: Sequence[Entry], key: str, axis_label: str) -> Figure | None:
    """Draw every metric over the number ``extra[key]`` of each entry; None with fewer than two numbers."""
    known = sorted((e for e in entries if _is_number(e.results.info.extra.get(key))), key=lambda e: _number(e, key))
    if len({_number(entry, key) for entry in known}) < 2:
        return None
    names, drawn = columns_of(known), by_condition(known)
    figure, axes = metric_panels(names, drawn)
    for panel, name in zip(axes, names, strict=False):
        for curve in drawn:
            numbers = np.array([_number(entry, key) for entry in curve.entries])
            draw_points(panel, numbers, [entry.summary[name] for entry in curve.entries], curve.colour)
        panel.set_xlabel(axis_label)
    return figure


def by_condition(entries: Sequence[Entry]) -> list[Curve]:
    """Group evaluations of one split, one capture rule and, in a study that has several, one condition."""
    groups: dict[tuple[str, ...], list[Entry]] = {}
    for entry in entries:
        info = entry.results.info
        groups.setdefault((info.split, info.capture, str(info.extra.get("condition", ""))), []).append(entry)
    varied = [len(set(names)) > 1 for names in zip(*groups, strict=True)]
    labels = [", ".join(compress(names, varied)) or names[0] for names in groups]
    colours = [COLOURS[place % len(COLOURS)] for place in range(len(groups))]
    drawn = zip(labels, colours, groups.values(), strict=True)
    return [Curve(clip(label), colour, members) for label, colour, members in drawn]


def _number(entry: Entry, key: str) -> float:
    return float(entry.results.info.extra[key])


def _is_number(value: object) -> bool:
    """Tell whether ``value`` is a number that an axis can show; JSON knows greater ones."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST_ON_AXIS
