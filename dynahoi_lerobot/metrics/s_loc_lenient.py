"""S_loc_lenient: localisation with the threshold that the paper grants vision-language models."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import LENIENT_RADIUS_M
from dynahoi_lerobot.metrics.base import FRACTION, metric


@metric("S_loc_lenient", unit=FRACTION, direction="higher", aggregation="rate")
def s_loc_lenient(episode: Episode) -> bool:
    """Lenient localisation: the palm centre comes within 1.0 u (0.1 m) of the target centre.

    ``S_loc_lenient = 1 if min_t |palm(t) - target(t)| < 1.0 u, else 0`` over the frames of the control phase.

    Fraction of episodes, higher is better. Paper: S_loc* of the table "Online evaluation of mainstream VLMs", threshold
    from Appendix "Evaluation Criteria".
    """
    return bool(episode.palm_distance[episode.control].min() < LENIENT_RADIUS_M)
