"""grasp_loose: share of frames in which at least three fingers hold the reference grasp."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric
from dynahoi_lerobot.metrics.fingers import share_of_frames


@metric("grasp_loose", unit=FRACTION, direction="higher", aggregation="mean")
def grasp_loose(episode: Episode) -> float:
    """Per-frame grasp, loose: the share of control frames in which at least three fingers match the reference.

    ``grasp_loose = mean_t [number of fingers whose three joints all pass the test of S_gra at t >= 3]``.

    Fraction of frames, higher is better. Paper: Figure "Grasp success rate under per-frame evaluation", setting Loose.
    """
    return share_of_frames(episode, at_least=3)
