"""Metrics over a parameter of training or evaluation, one line per group of evaluations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.report.entries import COLOURS, Entry, clip, short_name
from dynahoi_lerobot.report.figures.base import columns_of, draw_points, figure, metric_panels
from dynahoi_lerobot.rollout.inference import SYNC, Inference

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LARGEST_ON_AXIS = 1e12


Number = Callable[[Entry], object]
"""Maps an evaluation to its place on the axis; None if it has none."""
Group = Callable[[Entry], tuple[str, ...]]
"""Maps an evaluation to the names that its line shares."""


@dataclass(frozen=True)
class Curve:
    """Evaluations on one line.

    Attributes:
        label: the names that tell it from the others.
        colour: hexadecimal RGB.
        entries: in the order of their numbers.
    """

    label: str
    colour: str
    entries: Sequence[Entry]


def curves(entries: Sequence[Entry], number: Number, axis_label: str, group: Group | None = None) -> Figure | None:
    """Draw every metric over the number of each entry; None with fewer than two numbers.

    Args:
        entries: the evaluations.
        number: of an evaluation.
        axis_label: what the number is.
        group: which evaluations a line leads through; by default those under one condition.
    """
    known = sorted((e for e in entries if _is_number(number(e))), key=lambda e: _float(number(e)))
    if len({_float(number(entry)) for entry in known}) < 2:
        return None
    names, drawn = columns_of(known), grouped(known, group or condition)
    figure, axes = metric_panels(names, drawn)
    for panel, name in zip(axes, names, strict=False):
        for curve in drawn:
            numbers = np.array([_float(number(entry)) for entry in curve.entries])
            draw_points(panel, numbers, [entry.summary[name] for entry in curve.entries], curve.colour)
        panel.set_xlabel(axis_label)
    return figure


def stored(key: str) -> Number:
    """Return the number that results say as ``extra[key]``."""
    return lambda entry: entry.results.info.extra.get(key)


def condition(entry: Entry) -> tuple[str, ...]:
    """Return split, capture rule and, in a study that has several, the condition and the training seed."""
    info = entry.results.info
    seed = info.extra.get("training_seed")
    return info.split, info.capture, str(info.extra.get("condition", "")), "" if seed is None else f"seed {seed}"


def grouped(entries: Sequence[Entry], group: Group) -> list[Curve]:
    """Put evaluations whose group has the same names on one line, named by those that differ."""
    groups: dict[tuple[str, ...], list[Entry]] = {}
    for entry in entries:
        groups.setdefault(group(entry), []).append(entry)
    varied = [len(set(names)) > 1 for names in zip(*groups, strict=True)]
    labels = [", ".join(filter(None, compress(names, varied))) or names[0] for names in groups]
    colours = [COLOURS[place % len(COLOURS)] for place in range(len(groups))]
    drawn = zip(labels, colours, groups.values(), strict=True)
    return [Curve(clip(label), colour, members) for label, colour, members in drawn]


def _float(value: object) -> float:
    assert isinstance(value, int | float)
    return float(value)


def _is_number(value: object) -> bool:
    """Tell whether ``value`` is a number that an axis can show; JSON knows greater ones."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST_ON_AXIS


@figure("obs-frames", "Observed frames", place=80)
def obs_frames(entries: Sequence[Entry]) -> Figure | None:
    """The metrics over the number of observed frames s (Figure "Obs-frames ablation").

    Shows evaluations with ``n_obs_frames``, one line per ``condition`` of a study.
    """
    return curves(entries, stored("n_obs_frames"), "observed frames s")


@figure("latency", "Inference latency", place=85)
def latency(entries: Sequence[Entry]) -> Figure | None:
    """The metrics over the latency of inference, one line per policy and mode.

    Drawn from evaluations under ``--inference async`` or ``rtc`` with a declared latency; 0 where the world waits.
    """
    return curves(entries, declared_ms, "latency of an inference [ms]", policy_and_rules)


def declared_ms(entry: Entry) -> float | None:
    """Return the declared latency of an evaluation [ms]; None if it was measured."""
    timing = _timing(entry)
    return None if timing is None else timing.latency_ms


def policy_and_rules(entry: Entry) -> tuple[str, ...]:
    """Return policy, inference mode, split, capture rule and control class of an evaluation."""
    results, timing = entry.results, _timing(entry) or Inference()
    bridged = "corrected" if timing.corrected else ""
    return short_name(results.info.policy), bridged, results.info.split, results.capture, results.control_class


def _timing(entry: Entry) -> Inference | None:
    """Return the latency of an evaluation's inference; None if its label does not state it."""
    label = entry.results.inference
    try:
        return Inference.from_label("" if label == SYNC else label)
    except ValueError:
        return None


@figure("data-scaling", "Training data", place=90)
def data_scaling(entries: Sequence[Entry]) -> Figure | None:
    """The metrics over the share of the training data (Figure "Training-data scaling").

    Shows evaluations with ``data_fraction``.
    """
    return curves(entries, stored("data_fraction"), "share of the training data")
