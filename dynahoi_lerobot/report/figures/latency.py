"""What inference that takes time costs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynahoi_lerobot.report.entries import Entry, short_name
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.curves import curves
from dynahoi_lerobot.rollout.inference import SYNC, Inference

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@figure("latency", "Inference latency", place=85)
def latency(entries: Sequence[Entry]) -> Figure | None:
    """The metrics over the time that an inference takes, a line for each policy and way of bridging it.

    Drawn from evaluations under ``--inference async`` or ``rtc`` with a declared latency; 0 where the world waits.
    """
    return curves(entries, declared_ms, "latency of an inference [ms]", policy_and_rules)


def declared_ms(entry: Entry) -> float | None:
    """Return the declared latency of an evaluation [ms]; None if it was measured."""
    timing = _timing(entry)
    return None if timing is None else timing.latency_ms


def policy_and_rules(entry: Entry) -> tuple[str, ...]:
    """Return the policy of an evaluation, how it bridged the latency, split, capture rule and control class."""
    results, timing = entry.results, _timing(entry) or Inference()
    bridged = "corrected" if timing.corrected else ""
    return short_name(results.info.policy), bridged, results.info.split, results.capture, results.control_class


def _timing(entry: Entry) -> Inference | None:
    """Return how long the inferences of an evaluation took; None if its label does not say it."""
    label = entry.results.inference
    try:
        return Inference.from_label("" if label == SYNC else label)
    except ValueError:
        return None
