"""Q_line: spatial linearity of the palm's path."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import SCORE, metric
from dynahoi_lerobot.metrics.trajectory import palm_steps


@metric("Q_line", unit=SCORE, direction="higher", aggregation="mean", bounds=(-1.0, 1.0))
def q_line(episode: Episode) -> float:
    """Spatial linearity of the palm's path from control start to the first localised frame.

    ``Q_line = 1 / (N - 1) * sum_t s_t . v`` with the unit directions ``s_t`` of the steps and ``v`` of the whole
    displacement; 0 without displacement or if the palm stays within 1 mm, and a step of zero length adds 0.

    Score in [-1, 1], higher is better. Paper: Section "Evaluation metrics".
    """
    return linearity(*palm_steps(episode))


def linearity(steps: np.ndarray, displacement: np.ndarray) -> float:
    """Return the mean cosine between (M, D) steps and the (D,) displacement, 0 where either vanishes."""
    lengths, distance = np.linalg.norm(steps, axis=1), np.linalg.norm(displacement)
    if distance == 0 or len(steps) == 0:
        return 0.0
    cosines = np.divide(steps @ displacement, lengths * distance, out=np.zeros(len(steps)), where=lengths > 0)
    return float(np.clip(cosines.mean(), -1.0, 1.0))
