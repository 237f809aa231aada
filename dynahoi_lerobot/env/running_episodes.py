"""The episodes that a vector environment is playing, and what it tells about them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dynahoi_lerobot.env.rewards import DENSE, SPARSE, Progress
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.metrics import measure
from dynahoi_lerobot.phase import is_acting
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.rollout.session import Session
from dynahoi_lerobot.world.batch import WorldBatch

POLICY_NAME = "policy"
EpisodeListener = Callable[[Episode], None]


class RunningEpisodes(Session):
    """One recorded episode in each of the N worlds of a batch.

    Attributes:
        longest: (N,) int, longest length of each world's episode [frames].
    """

    def __init__(self, batch: WorldBatch, on_episode: EpisodeListener | None, reward: str = SPARSE) -> None:
        """Record what ``batch`` plays, hand every finished Episode to ``on_episode`` and give a ``reward``."""
        super().__init__(batch, record_images=False)
        self._progress = Progress(batch) if reward == DENSE else None
        self._on_episode = on_episode
        self._success = np.zeros(batch.size, bool)
        self.longest = np.zeros(batch.size, int)

    def begin_specs(self, ids: np.ndarray, specs: list[EpisodeSpec]) -> None:
        """Begin the evaluation of an episode in each of the sorted worlds ``ids`` (n,)."""
        jobs = [Job.evaluation(int(i), spec) for i, spec in zip(ids, specs, strict=True)]
        self.begin(ids, jobs)
        self.longest[ids] = [job.frames for job in jobs]
        self._success[ids] = False
        if self._progress is not None:
            self._progress.take()

    def rewards(self, ending: np.ndarray) -> np.ndarray:
        """Return (N,) the reward of the step that was just made; episodes of worlds ``ending`` (N,) bool end with it.

        Call it after ``infos``, and before the next episodes begin.
        """
        rewards = (self._success & ending).astype(np.float64)
        if self._progress is None or self.observation is None:
            return rewards
        acted = is_acting(self.observation.phase)
        playing = np.isin(np.arange(self.batch.size), self.playing) | ending
        return rewards + self._progress.advance(acted & playing)

    def infos(self, ending: np.ndarray) -> dict[str, Any]:
        """End the episodes of worlds ``ending`` (n,) and return what is told after a step.

        Returns:
            ``is_success`` (N,) so far, and every metric of those that end, (N,) with NaN for the others.
        """
        for i in self.playing:
            self._success[i] = self.success(int(i))
        mask = np.isin(np.arange(self.batch.size), ending)
        infos: dict[str, Any] = {"is_success": self._success.copy()}
        for i in ending:
            episode = self.finish(int(i), POLICY_NAME)
            if self._on_episode is not None:
                self._on_episode(episode)
            for name, value in measure(episode).items():
                column = infos.setdefault(name, np.full(self.batch.size, np.nan))
                column[i] = np.nan if value is None else value
                infos["_" + name] = mask
        return infos
