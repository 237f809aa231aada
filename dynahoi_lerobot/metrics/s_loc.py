"""S_loc: localisation success."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric


@metric("S_loc", unit=FRACTION, direction="higher", aggregation="rate")
def s_loc(episode: Episode) -> bool:
    """Localisation success: the palm centre comes within 0.3 u (0.03 m) of the target centre.

    ``S_loc = 1 if exists t >= t_control: |palm(t) - target(t)| < 0.3 u, else 0``, the distance in 3-D and between
    frames as well, over the control phase. Under the capture rule attach_lenient the threshold is 1.0 u (S_loc* of the
    paper's table of vision-language models), here and wherever a metric speaks of localisation.

    Fraction of episodes, higher is better. Paper: Section "Evaluation metrics", threshold from Appendix "Evaluation
    Criteria".
    """
    return episode.first_localized is not None
