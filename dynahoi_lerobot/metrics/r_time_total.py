"""R_time_total: completion speed, counted from the first observed frame."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric
from dynahoi_lerobot.metrics.r_time import time_score


@metric("R_time_total", unit=SCORE, direction="higher", aggregation="mean")
def r_time_total(episode: Episode) -> float:
    """Time score, counted from the first frame, so that observing costs time too; 0 if the target is never localised.

    ``R_time_total = 1 - T / N``, clipped to [0, 1], with N the recording's length and T the frames from the episode's
    start to the first localised one.

    Score in [0, 1], higher is better. Ours: the other reading of the paper's Section "Evaluation metrics".
    """
    return time_score(episode, start_frame=0)
