"""S_gra_two_sided: grasp success that a fist does not have."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import GRASP_FRACTION
from dynahoi_lerobot.metrics.base import FRACTION, metric

LARGEST_FRACTION = 1.2
"""Share of the reference rotation that no joint may exceed."""


@metric("S_gra_two_sided", unit=FRACTION, direction="higher", aggregation="rate", condition="localised episodes")
def s_gra_two_sided(episode: Episode) -> bool | None:
    """Grasp success, given localisation, with joints neither too open nor too closed.

    ``S_gra_two_sided = 1 if for all j: 0.9 <= (q_j - open_j) / (ref_j - open_j) <= 1.2, else 0`` with the joint angles
    q at the first localised frame; joints that the reference leaves open do not count. None if the target is never
    localised.

    Fraction of localised episodes, higher is better. Ours: a fist passes the paper's S_gra for every object.
    """
    first = episode.first_localized
    if first is None:
        return None
    wanted = episode.reference_joints - episode.open_joints
    counts = np.abs(wanted) > 1e-6
    share = (episode.joints[first] - episode.open_joints)[counts] / wanted[counts]
    return bool(((share >= GRASP_FRACTION - 1e-6) & (share <= LARGEST_FRACTION + 1e-6)).all())
