"""Histograms of the commanded motion, one outline per evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.foundation.conventions import HAND_DOF
from dynahoi_lerobot.report.entries import Entry

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
