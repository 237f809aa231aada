"""S_loc_lenient: the threshold granted to vision-language models."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import LENIENT_RADIUS_M
from dynahoi_lerobot.metrics.base import FRACTION, metric


@metric("S_loc_lenient", unit=FRACTION, direction="higher", kind="rate")
def s_loc_lenient(episode: Episode) -> bool:
    """Lenient localisation: the palm centre comes within 1.0 u of the target centre.

    ``[min_t |palm - target| < 1.0 u]`` over the control phase: the S_loc* of the paper's table of
    vision-language models (Appendix "Evaluation Criteria").
    """
    return bool(episode.palm_distance[episode.control].min() < LENIENT_RADIUS_M)
