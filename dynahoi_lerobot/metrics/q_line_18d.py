"""Q_line_18d: linearity as the authors' code computes it."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric
from dynahoi_lerobot.metrics.commands import command_steps
from dynahoi_lerobot.metrics.q_line import linearity


@metric("Q_line_18d", unit=SCORE, direction="higher", aggregation="mean", bounds=(-1.0, 1.0))
def q_line_18d(episode: Episode) -> float:
    """Legacy linearity: Q_line on the 18-D commands (palm in u, joints in rad), steps up to 1e-4 dropped.

    ``Q_line_18d = 1 / (N - 1) * sum_t s_t . v`` with the unit directions of ``a_{t+1} - a_t`` and of ``a_N - a_1``.

    Score in [-1, 1], higher is better. Source: the authors' evaluation code; for comparison with their logs only.
    """
    return linearity(*command_steps(episode))
