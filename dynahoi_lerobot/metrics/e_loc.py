"""E_loc: localisation error."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import UNIT_M
from dynahoi_lerobot.metrics.base import UNIT, metric


@metric("E_loc", unit=UNIT, direction="lower", aggregation="mean", bounds=(0.0, float("inf")))
def e_loc(episode: Episode) -> float:
    """Localisation error: the least distance between palm centre and target centre.

    ``E_loc = min_t |palm(t) - target(t)| / 0.1 m`` over the frames of the control phase.

    In u (0.1 m), lower is better. Paper: Section "Evaluation metrics".
    """
    return float(episode.palm_distance[episode.control].min()) / UNIT_M
