"""Playing: worlds that are observed, moved and recorded frame by frame. Rollouts and environments both do it here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.agent import Meeting, Observation
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.rollout.recorder import Job, WorldRecorder, frame_columns
from dynahoi_lerobot.world.batch import WorldBatch


@dataclass(frozen=True, eq=False)
class Ended:
    """Which worlds ended their episode in one step.

    Attributes:
        settled: (n,) sorted worlds in which the capture rule's verdict has fallen.
        full: (n,) sorted worlds that reached the longest length without.
    """

    settled: np.ndarray
    full: np.ndarray

    @property
    def worlds(self) -> np.ndarray:
        """(n,) all of them, sorted."""
        return np.union1d(self.settled, self.full).astype(int)


class Session:
    """Some of the worlds of a batch, each in the middle of its job.

    Attributes:
        batch: the worlds.
        observation: what was seen last, of all worlds.
    """

    def __init__(self, batch: WorldBatch, *, record_images: bool = True) -> None:
        """Play in ``batch``; ``record_images`` keeps what was rendered for the episodes."""
        self.batch, self.record_images = batch, record_images
        self.observation: Observation | None = None
        self._recorders: dict[int, WorldRecorder] = {}

    @property
    def playing(self) -> np.ndarray:
        """(n,) sorted worlds that play."""
        return np.array(sorted(self._recorders), int)

    def begin(self, ids: Sequence[int] | np.ndarray, jobs: Sequence[Job]) -> None:
        """Begin a job in each of the sorted worlds ``ids``; what was played there is dropped."""
        self.batch.reset(ids, [job.spec for job in jobs], [job.attempt for job in jobs])
        self._recorders.update((int(i), WorldRecorder(job)) for i, job in zip(ids, jobs, strict=True))

    def observe(self, *, images: bool = True, ending: np.ndarray | None = None) -> Observation:
        """Return what is seen of all worlds; only worlds that play, and ``ending`` (n,), are rendered."""
        shown = self.playing if ending is None else np.union1d(self.playing, ending)
        self.observation = self.batch.observe(images=images, ids=shown)
        return self.observation

    def step(self, commands: np.ndarray, labels: dict[str, np.ndarray] | None = None) -> Ended:
        """Record what was observed, move the worlds that play by one frame, and tell which have ended.

        Args:
            commands: (N, 18) of all worlds; those of worlds that do not play are ignored.
            labels: (N, ...) what a teacher says of this frame, by name in ``Episode``; None without a teacher.

        Raises:
            ValueError: for a wrong shape or a value that is not finite; nothing has moved then.
            RuntimeError: if nothing was observed yet.
        """
        if self.observation is None:
            raise RuntimeError("observe before the first step")
        checked, ids = self.batch.check(commands), self.playing
        columns = frame_columns(self.batch, self.observation)
        images = self.observation.images if self.record_images else {}
        for i, recorder in self._recorders.items():
            recorder.add_frame(columns, i, images)
        self.batch.step(checked[ids], ids)
        for i, recorder in self._recorders.items():
            label = None if labels is None else {name: values[i] for name, values in labels.items()}
            recorder.add_action(self.batch.commanded[i], label)
        settled = [i for i in ids if self._recorders[i].settled(self.batch.rule)]
        full = [i for i in ids if self._recorders[i].full and i not in settled]
        return Ended(np.array(settled, int), np.array(full, int))

    def success(self, i: int) -> bool:
        """Return the verdict on what world ``i`` has played so far."""
        return self._recorders[i].success(self.batch.rule)

    def job(self, i: int) -> Job:
        """Return what world ``i`` plays."""
        return self._recorders[i].job

    def finish(self, i: int, actor: str, meeting: Meeting | None = None) -> Episode:
        """End the episode of world ``i`` and return the recording, which names the actor and has its plan, if any."""
        return self._recorders.pop(i).freeze(self.batch, actor, meeting)
