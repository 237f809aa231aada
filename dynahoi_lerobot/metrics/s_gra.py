"""S_gra: was the hand in the reference grasp when it arrived?"""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric
from dynahoi_lerobot.metrics.fingers import grasps_at


@metric("S_gra", unit=FRACTION, direction="higher", kind="rate", condition="localised episodes")
def s_gra(episode: Episode) -> bool | None:
    """Grasp success, given localisation: all 15 joints match the reference at the first localised frame.

    A joint matches when it turned in the reference's direction by at least 0.9 of its rotation (Section
    "Evaluation metrics" and Appendix "Evaluation Criteria"). Episodes that never localise do not count.
    """
    first = episode.first_localized
    return None if first is None else grasps_at(episode, slice(first, first + 1))
