"""Q_smooth_18d: smoothness as the authors' code computes it."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric
from dynahoi_lerobot.metrics.commands import command_steps
from dynahoi_lerobot.metrics.q_smooth import smoothness


@metric("Q_smooth_18d", unit=SCORE, direction="higher", kind="mean")
def q_smooth_18d(episode: Episode) -> float:
    """Legacy smoothness: Q_smooth on the 18-D commands (palm in u, joints in rad), steps up to 1e-4 dropped.

    This reproduces the quantity that the authors' logs contain, for comparison with their table only. Without
    any step it is 1, where theirs is not a number.
    """
    return smoothness(command_steps(episode)[0])
