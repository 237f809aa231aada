"""R_time_total: how early the hand arrived, observation included."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric
from dynahoi_lerobot.metrics.r_time import time_score


@metric("R_time_total", unit=SCORE, direction="higher", kind="mean")
def r_time_total(episode: Episode) -> float:
    """Time score, clock from the first frame: as R_time, but watching costs time too.

    ``1 - T / N`` with T counted from the episode's start and the same N, so it is R_time less the window's
    share.
    """
    return time_score(episode, start_frame=0)
