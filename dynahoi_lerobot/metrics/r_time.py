"""R_time: how early the hand arrived."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric


@metric("R_time", unit=SCORE, direction="higher", kind="mean")
def r_time(episode: Episode) -> float:
    """Time score, clock from control start: ``R_time = 1 - T / N``, 0 if never localised.

    N is the recording's length [frames], T the frames from control start to the first localised one; the
    result is clipped to [0, 1] (Section "Evaluation metrics"; the clock's start follows the authors'
    evaluation).
    """
    return time_score(episode, start_frame=episode.meta.window_frames)


def time_score(episode: Episode, start_frame: int) -> float:
    """Return ``1 - (first localised frame - start_frame) / length_frames`` in [0, 1], 0 if there is none."""
    first = episode.first_localized
    if first is None:
        return 0.0
    return float(np.clip(1 - (first - start_frame) / episode.meta.length_frames, 0.0, 1.0))
