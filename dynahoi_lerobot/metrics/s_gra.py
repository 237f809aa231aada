"""S_gra: grasp success at the moment of localisation."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric
from dynahoi_lerobot.metrics.fingers import grasps_at


@metric("S_gra", unit=FRACTION, direction="higher", aggregation="rate", condition="localised episodes")
def s_gra(episode: Episode) -> bool | None:
    """Grasp success, given localisation: all 15 joints match the reference grasp at the first localised frame.

    ``S_gra = 1 if for all j: (q_j - open_j) / (ref_j - open_j) >= 0.9, else 0`` with the joint angles q at that frame:
    each joint has turned in the direction of the reference, by at least 0.9 of its rotation. None if the target is
    never localised.

    Fraction of localised episodes, higher is better. Paper: Section "Evaluation metrics" and Appendix "Evaluation
    Criteria".
    """
    first = episode.first_localized
    return None if first is None else grasps_at(episode, slice(first, first + 1))
