"""grasp_loose: three fingers hold the reference grasp."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric
from dynahoi_lerobot.metrics.fingers import share_of_frames


@metric("grasp_loose", unit=FRACTION, direction="higher", kind="mean")
def grasp_loose(episode: Episode) -> float:
    """Per-frame grasp, loose: the share of control frames with at least three fingers at the reference.

    A finger holds when its three joints all pass the test of S_gra (Figure "Grasp success rate under
    per-frame evaluation", setting Loose).
    """
    return share_of_frames(episode, at_least=3)
