"""S_loc: did the palm come to the target?"""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric


@metric("S_loc", unit=FRACTION, direction="higher", kind="rate")
def s_loc(episode: Episode) -> bool:
    """Localisation success: the palm centre comes within 0.3 u of the target centre in the control phase.

    ``S_loc = [exists t >= t_control: localized(t)]``, the 3-D distance of Section "Evaluation metrics" with
    the threshold of Appendix "Evaluation Criteria" (0.3 u = 0.03 m).
    """
    return episode.first_localized is not None
