"""E_gra: grasping error."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import UNIT_M
from dynahoi_lerobot.metrics.base import UNIT, metric


@metric("E_gra", unit=UNIT, direction="lower", aggregation="mean", bounds=(0.0, float("inf")))
def e_gra(episode: Episode) -> float:
    """Grasping error: the least distance between a fingertip and the target's surface.

    ``E_gra = min_{t, finger} dist(tip(t), surface(t)) / 0.1 m`` over the frames of the control phase; 0 inside the
    target.

    In u (0.1 m), lower is better. Paper: Section "Evaluation metrics".
    """
    return float(episode.fingertip_distance[episode.control].min()) / UNIT_M
