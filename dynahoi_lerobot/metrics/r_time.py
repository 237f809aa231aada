"""R_time: completion speed, counted from control start."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric


@metric("R_time", unit=SCORE, direction="higher", aggregation="mean")
def r_time(episode: Episode) -> float:
    """Time score, counted from control start; 0 if the target is never localised.

    ``R_time = 1 - T / N``, clipped to [0, 1], with N the recording's length and T the frames from control start to the
    first localised one.

    Score in [0, 1], higher is better. Paper: Section "Evaluation metrics"; the start of the clock follows the authors'
    evaluation code.
    """
    return time_score(episode, start_frame=episode.meta.window_frames)


def time_score(episode: Episode, start_frame: int) -> float:
    """Return ``1 - (first localised frame - start_frame) / length_frames`` in [0, 1], 0 if there is none."""
    first = episode.first_localized
    if first is None:
        return 0.0
    return float(np.clip(1 - (first - start_frame) / episode.meta.length_frames, 0.0, 1.0))
