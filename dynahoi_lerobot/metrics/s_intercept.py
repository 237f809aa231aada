"""S_intercept: localisation at the first opportunity."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ
from dynahoi_lerobot.metrics.base import FRACTION, metric

SPARE_FRAMES = round(0.1 * CONTROL_HZ)
"""A target localised up to 0.1 s after the oracle's intercept still counts as met there."""


@metric("S_intercept", unit=FRACTION, direction="higher", aggregation="rate")
def s_intercept(episode: Episode) -> bool:
    """Localisation at the first opportunity: no later than 0.1 s after the oracle's intercept.

    ``S_intercept = 1 if t_loc <= t_intercept + 0.1 s, else 0`` with the first localised frame of the control phase and
    the earliest intercept that a hand of 0.3 m/s can reach.

    Fraction of episodes, higher is better. Ours: a hand that follows its target and catches it later needs
    no prediction.
    """
    first = episode.first_localized
    return first is not None and first <= episode.meta.intercept_frame + SPARE_FRAMES
