"""E_gra: how close the fingertips came."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import UNIT_M
from dynahoi_lerobot.metrics.base import UNIT, metric


@metric("E_gra", unit=UNIT, direction="lower", kind="mean", bounds=(0.0, float("inf")))
def e_gra(episode: Episode) -> float:
    """Grasping error: the least fingertip to target surface distance, in u (0.1 m) as in the paper.

    ``E_gra = min_{t, finger} dist(tip(t), surface(t)) / 0.1 m`` over the control phase, 0 inside the target
    (Section "Evaluation metrics").
    """
    return float(episode.fingertip_distance[episode.control].min()) / UNIT_M
