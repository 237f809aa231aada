"""S_gra_window: grasp success within half a second of localisation."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ
from dynahoi_lerobot.metrics.base import FRACTION, metric
from dynahoi_lerobot.metrics.fingers import grasps_at

WINDOW_S = 0.5
"""How long after localisation the grasp may close [s]."""


@metric("S_gra_window", unit=FRACTION, direction="higher", aggregation="rate", condition="localised episodes")
def s_gra_window(episode: Episode) -> bool | None:
    """Grasp success within 0.5 s, given localisation: the test of S_gra on the first localised frame and ten more.

    ``S_gra_window = 1 if S_gra's condition holds at any t in [t_loc, t_loc + 0.5 s], else 0``; None if the target is
    never localised.

    Fraction of localised episodes, higher is better. Ours: S_gra judges one instant, which a hand that closes 50 ms
    late fails.
    """
    first = episode.first_localized
    return None if first is None else grasps_at(episode, slice(first, first + round(WINDOW_S * CONTROL_HZ) + 1))
