"""grasp_strict: share of frames in which all five fingers hold the reference grasp."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric
from dynahoi_lerobot.metrics.fingers import share_of_frames


@metric("grasp_strict", unit=FRACTION, direction="higher", aggregation="mean")
def grasp_strict(episode: Episode) -> float:
    """Per-frame grasp, strict: the share of control frames in which all five fingers match the reference.

    ``grasp_strict = mean_t [number of fingers whose three joints all pass the test of S_gra at t >= 5]``.

    Fraction of frames, higher is better. Paper: Figure "Grasp success rate under per-frame evaluation", setting Strict.
    """
    return share_of_frames(episode, at_least=5)
