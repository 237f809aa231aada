"""S_loc_planar: localisation by horizontal distance, as the authors' code measures it."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import LENIENT_RADIUS_M, LOCALIZATION_RADIUS_M
from dynahoi_lerobot.metrics.base import FRACTION, metric
from dynahoi_lerobot.metrics.trajectory import until_localized


@metric("S_loc_planar", unit=FRACTION, direction="higher", aggregation="rate")
def s_loc_planar(episode: Episode) -> bool:
    """Planar localisation: the horizontal distance of palm and target centre falls below 0.3 u (0.03 m).

    ``S_loc_planar = 1 if exists t: |(palm(t) - target(t))_xy| < 0.3 u, else 0`` over the control frames until the
    target is attached; 3-D localisation implies it, also between two frames. Under attach_lenient within 1.0 u.

    Fraction of episodes, higher is better. Source: the authors' evaluation code, which ignores height where the paper's
    Section "Evaluation metrics" says distance.
    """
    if episode.first_localized is not None:
        return True
    frames = until_localized(episode)
    offset = episode.palm_pos_h[frames, :2] - episode.target_pose[frames, :2]  # (T, 2)
    radius_m = LENIENT_RADIUS_M if episode.meta.capture == "attach_lenient" else LOCALIZATION_RADIUS_M
    return bool((np.linalg.norm(offset, axis=1) < radius_m).any())
