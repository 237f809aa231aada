"""A student whose inferences take time, in each episode another."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.onpolicy.recipe import StudentInference
from dynahoi_lerobot.onpolicy.student import Learner, Student
from dynahoi_lerobot.rollout.inference import SYNC, Inference, RealTimeAgent, frames_of


class LateStudent(RealTimeAgent):
    """A learner with one inference in flight in each world.

    With latencies from 0 on it learns to plan with any of them, and what a chunk continues tells it which
    (training-time real-time chunking, arXiv 2512.05964).
    """

    def __init__(self, learner: Learner, timing: StudentInference, rng: np.random.Generator) -> None:
        """Draw the latency of each episode from ``rng`` when it begins."""
        self._range_ms, self._rng = timing.range_ms, rng
        super().__init__(learner, Inference(timing.mode, timing.range_ms[1], timing.corrected))

    def _declared(self, count: int) -> list[int | None]:
        """See `RealTimeAgent`."""
        return [frames_of(ms / 1000) for ms in self._rng.uniform(*self._range_ms, count)]


def acting_student(learner: Learner, timing: StudentInference, rng: np.random.Generator) -> Student:
    """Return who moves the hands: the learner itself, or with inferences that take time."""
    return learner if timing.mode == SYNC else LateStudent(learner, timing, rng)
