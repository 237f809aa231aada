"""S_loc_planar: localisation as the authors' code measures it, with height ignored."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import LOCALIZATION_RADIUS_M
from dynahoi_lerobot.metrics.base import FRACTION, metric
from dynahoi_lerobot.metrics.trajectory import until_localized


@metric("S_loc_planar", unit=FRACTION, direction="higher", kind="rate")
def s_loc_planar(episode: Episode) -> bool:
    """Planar localisation: the horizontal palm to target distance falls below 0.3 u.

    ``[exists t: |(palm - target)_xy| < 0.3 u]`` over control frames until the target is attached. The paper's
    text says distance, its code ignores height. Localisation in 3-D implies it, also between two frames.
    """
    if episode.first_localized is not None:
        return True
    frames = until_localized(episode)
    offset = episode.palm_pos_w[frames, :2] - episode.target_pose[frames, :2]  # (T, 2)
    return bool((np.linalg.norm(offset, axis=1) < LOCALIZATION_RADIUS_M).any())
