"""Distribution of joint rotations per frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.foundation.conventions import JOINT_NAMES, PALM_DOF
from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.figures.base import figure
from dynahoi_lerobot.report.figures.histograms import command_deltas, overlay
from dynahoi_lerobot.report.style import legend, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
