"""Q_line_18d: linearity as the authors' code computes it."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric
from dynahoi_lerobot.metrics.commands import command_steps
from dynahoi_lerobot.metrics.q_line import linearity


@metric("Q_line_18d", unit=SCORE, direction="higher", kind="mean", bounds=(-1.0, 1.0))
def q_line_18d(episode: Episode) -> float:
    """Legacy linearity: Q_line on the 18-D commands (palm in u, joints in rad), steps up to 1e-4 dropped.

    This reproduces the quantity that the authors' logs contain, for comparison with their table only.
    """
    return linearity(*command_steps(episode))
