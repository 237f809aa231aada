"""Q_smooth_18d: smoothness as the authors' code computes it."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric
from dynahoi_lerobot.metrics.commands import command_steps
from dynahoi_lerobot.metrics.q_smooth import smoothness


@metric("Q_smooth_18d", unit=SCORE, direction="higher", aggregation="mean")
def q_smooth_18d(episode: Episode) -> float:
    """Legacy smoothness: Q_smooth on the 18-D commands (palm in u, joints in rad), steps up to 1e-4 dropped.

    ``Q_smooth_18d = 1 / (1 + CV(d))`` with ``d_t = |a_{t+1} - a_t|``; 1 without any step, where the authors' value is
    not a number.

    Score in [0, 1], higher is better. Source: the authors' evaluation code; for comparison with their logs only.
    """
    return smoothness(command_steps(episode)[0])
