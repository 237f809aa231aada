"""grasp_strict: five fingers hold the reference grasp."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric
from dynahoi_lerobot.metrics.fingers import share_of_frames


@metric("grasp_strict", unit=FRACTION, direction="higher", kind="mean")
def grasp_strict(episode: Episode) -> float:
    """Per-frame grasp, strict: the share of control frames with all five fingers at the reference.

    A finger holds when its three joints all pass the test of S_gra (Figure "Grasp success rate under
    per-frame evaluation", setting Strict).
    """
    return share_of_frames(episode, at_least=5)
