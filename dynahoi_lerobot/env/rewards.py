"""What the environments reward: success alone, or progress towards the target as well."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.foundation.conventions import PALM_DOF, UNIT_M
from dynahoi_lerobot.world.batch import WorldBatch

SPARSE, DENSE = "sparse", "dense"
REWARDS = {
    SPARSE: "1 at the frame at which the episode ends in success, else 0",
    DENSE: "the same, plus (d - d') / 0.1 m in the control phase: how much closer palm and target have come",
}
"""Name: formula. ``d`` and ``d'`` are the distances from palm centre to target centre before and after the step."""


def check_reward(name: str) -> None:
    """Refuse a reward that does not exist.

    Raises:
        ValueError: naming the reward received and those there are.
    """
    if name not in REWARDS:
        raise ValueError(f"unknown reward {name!r}; known: {', '.join(REWARDS)}")


class Progress:
    """Potential-based shaping F = Phi(s') - Phi(s), with Phi = -d / 0.1 m (Ng, Harada and Russell, 1999, gamma = 1).

    Its sum over an episode depends on the first and the last distance only, so it changes no policy's rank.
    """

    def __init__(self, batch: WorldBatch) -> None:
        """Follow the N worlds of a batch."""
        self._batch, self._before_m = batch, np.zeros(batch.size)

    def advance(self, counted: np.ndarray) -> np.ndarray:
        """Return (N,) what the last step brought, 0 for worlds that are not ``counted`` (N,) bool.

        Call it after every step; distances of all worlds are taken up as they are now.
        """
        gained_m = self._before_m - self.take()
        return np.where(counted, gained_m / UNIT_M, 0.0)

    def take(self) -> np.ndarray:
        """Take up and return the (N,) distances [m] as they are now, as at the beginning of episodes."""
        self._before_m = np.linalg.norm(self._batch.target_pose[:, :3] - self._batch.state[:, :PALM_DOF], axis=1)
        return self._before_m
