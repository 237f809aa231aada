"""relative_speed: how fast palm and target move against each other when they meet."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import CONTROL_DT
from dynahoi_lerobot.metrics.base import SPEED, metric


@metric(
    "relative_speed",
    unit=SPEED,
    direction="lower",
    aggregation="mean",
    bounds=(0.0, float("inf")),
    condition="localised episodes",
)
def relative_speed(episode: Episode) -> float | None:
    """Relative speed of palm and target at localisation.

    ``relative_speed = |v_target(t - 1) - (palm(t) - palm(t - 1)) / 0.05 s|`` with t the first
    localised frame: the target's velocity of the frame before, as a welded target has the palm's, and the palm's mean
    velocity in between. None if the target is never localised.

    In m/s, lower is better. Ours: under ``attach`` a target is caught at any speed, which no hand can.
    """
    first = episode.first_localized
    if first is None:
        return None
    palm_velocity = (episode.palm_pos_h[first] - episode.palm_pos_h[first - 1]) / CONTROL_DT
    return float(np.linalg.norm(episode.target_velocity[first - 1, :3] - palm_velocity))
