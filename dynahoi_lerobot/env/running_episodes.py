"""The episodes that a vector environment is playing: beginning them, recording them, telling how they end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dynahoi_lerobot.agent import Observation
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.metrics import measure
from dynahoi_lerobot.rollout.recorder import Job, WorldRecorder, frame_columns
from dynahoi_lerobot.world.batch import WorldBatch

POLICY_NAME = "policy"
EpisodeListener = Callable[[Episode], None]


class RunningEpisodes:
    """One recorded episode in each of the N worlds of a batch."""

    def __init__(self, batch: WorldBatch, on_episode: EpisodeListener | None) -> None:
        """Record what ``batch`` plays and hand every finished Episode to ``on_episode``."""
        self._batch, self._on_episode = batch, on_episode
        self._recorders: dict[int, WorldRecorder] = {}

    @property
    def longest(self) -> int:
        """Length of the longest one [frames]."""
        return max(recorder.job.frames for recorder in self._recorders.values())

    def begin(self, ids: np.ndarray, specs: list[EpisodeSpec]) -> None:
        """Begin an episode in each of the worlds ``ids`` (n,)."""
        self._batch.reset(ids, specs)
        self._recorders.update(
            (int(i), WorldRecorder(Job.evaluation(int(i), s))) for i, s in zip(ids, specs, strict=True)
        )

    def step(self, commands: np.ndarray, playing: np.ndarray, seen: Observation) -> None:
        """Advance the worlds ``playing`` (n,) by one frame and record it.

        Args:
            commands: (n, 18) for these worlds, palm positions [m], world, and joint angles [rad].
            playing: sorted, distinct worlds.
            seen: the observation of all N worlds that the commands answer.
        """
        columns = frame_columns(self._batch, seen)
        for i in playing:
            self._recorders[i].see(columns, i, {})
        self._batch.step(commands, playing)
        for i in playing:
            self._recorders[i].act(self._batch.executed[i])

    def endings(self, playing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (N,) bool terminated and truncated, after a step of the worlds ``playing`` (n,)."""
        terminated, truncated = np.zeros(self._batch.size, bool), np.zeros(self._batch.size, bool)
        for i in playing:
            terminated[i] = self._recorders[i].settled_at(self._batch.rule.settle_frames)
            truncated[i] = self._recorders[i].full() and not terminated[i]
        return terminated, truncated

    def infos(self, ending: np.ndarray) -> dict[str, Any]:
        """Return ``is_success`` so far of all worlds, and every metric of those that end (N,), NaN for the others."""
        success = [self._recorders[i].success(self._batch.rule) for i in range(self._batch.size)]
        infos: dict[str, Any] = {"is_success": np.array(success)}
        for i in np.flatnonzero(ending):
            episode = self._recorders[i].freeze(self._batch.rule, POLICY_NAME)
            if self._on_episode is not None:
                self._on_episode(episode)
            for name, value in measure(episode).items():
                column = infos.setdefault(name, np.full(self._batch.size, np.nan))
                column[i] = np.nan if value is None else value
                infos["_" + name] = ending
        return infos
