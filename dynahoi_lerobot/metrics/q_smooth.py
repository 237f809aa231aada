"""Q_smooth: temporal smoothness of the palm's path."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric
from dynahoi_lerobot.metrics.trajectory import palm_steps


@metric("Q_smooth", unit=SCORE, direction="higher", aggregation="mean")
def q_smooth(episode: Episode) -> float:
    """Temporal smoothness of the palm's path from control start to the first localised frame.

    ``Q_smooth = 1 / (1 + CV(d))`` with ``CV = sigma_d / mu_d`` (population standard deviation) of the step lengths
    ``d_t = |p_{t+1} - p_t|``, and ``CV = 0`` where ``mu_d = 0``: the palm stays within 1 mm of where it begins.

    Score in [0, 1], higher is better. Paper: Section "Evaluation metrics".
    """
    return smoothness(palm_steps(episode)[0])


def smoothness(steps: np.ndarray) -> float:
    """Return ``1 / (1 + CV)`` of the lengths of (M, D) steps, 1 where there is no motion."""
    lengths = np.linalg.norm(steps, axis=1)
    if not lengths.any():
        return 1.0
    return float(1.0 / (1.0 + lengths.std() / lengths.mean()))
