"""One task of the benchmark for LeRobot's evaluation loop, and the results it leaves behind.

LeRobot's loop keeps rewards and successes only, so the envs themselves write the benchmark's result folder: the same
files that ``dynahoi evaluate`` writes.
"""

from __future__ import annotations

import copy
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.env import DynahoiVectorEnv
from dynahoi_lerobot.env.vector_env import ONE_EPISODE_OPTION
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.evaluate.results import ResultsRecorder, RunInfo
from dynahoi_lerobot.evaluate.table import results_table
from dynahoi_lerobot.rollout.stepwise_inference import StepwiseInference
from dynahoi_lerobot.sampling.recipe import Recipe
from lerobot_env_dynahoi.played_policy import policy_name


class ResultsLog:
    """Collects the finished episodes of all tasks of one evaluation and writes them as one result folder."""

    def __init__(self, folder: Path, split: str, recipe: Recipe, inference: str = "") -> None:
        """Write episodes of ``recipe``, played with the timing ``inference``, into ``folder`` whenever a task ends."""
        self.folder, self._split, self._recipe, self._inference = folder, split, recipe, inference
        self._recorder = ResultsRecorder()
        self._known: set[tuple[str, int]] = set()
        self._unwritten = 0
        self._fingerprint = ""

    def add(self, episode: Episode) -> None:
        """Keep an episode, once: LeRobot fills its last batch with episodes it has played before."""
        key = (episode.meta.motion, episode.meta.seed)
        if key in self._known:
            return
        self._known.add(key)
        self._recorder.extend([episode])
        self._fingerprint = episode.meta.fingerprint
        self._unwritten += 1

    def write(self) -> None:
        """Write the folder if there is anything new, and print the table."""
        if not self._unwritten:
            return
        extra = {"recipe": self._recipe.stored(), "inference": self._inference}
        name, command = policy_name(sys.argv), " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])
        info = RunInfo(name, self._split, self._recipe.capture, command, self._fingerprint, extra)
        results = self._recorder.write(self.folder, info)
        self._unwritten = 0
        print(f"{results_table([results])}\nmetrics so far: {self.folder}", flush=True)


class TaskEnv(DynahoiVectorEnv):
    """A vector env of one kind of motion that reports its episodes to a log, and may let inference take time.

    With a timing of inference a step is a call of the policy. After some of them the world stands still: the
    observation is the one before, and nothing ends.
    """

    def __init__(
        self, log: ResultsLog, num_envs: int, *, inference: StepwiseInference | None = None, **options: Any
    ) -> None:
        """Take the log, the timing, which is no other env's, and the arguments of ``DynahoiVectorEnv``."""
        super().__init__(num_envs, on_episode=log.add, **options)
        self._log, self._inference = log, inference

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """See ``DynahoiVectorEnv.reset``.

        Raises:
            ValueError: if inference takes time and worlds would begin their next episodes at different frames.
        """
        if self._inference is not None:
            if not (options or {}).get(ONE_EPISODE_OPTION):
                option = f"options={{{ONE_EPISODE_OPTION!r}: True}}"
                raise ValueError(f"with inference async all worlds begin together; reset with {option}")
            self._inference.reset()
        self._seen = super().reset(seed=seed, options=options)
        return self._seen

    def step(self, actions: np.ndarray) -> tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """See ``DynahoiVectorEnv.step``."""
        if self._inference is None:
            return super().step(actions)
        commands = self._inference.answer(self._batch.check(actions), self._observed().state.astype(np.float64))
        if commands is None:
            observation, infos = self._seen
            nothing = np.zeros(self.num_envs, bool)
            return observation, np.zeros(self.num_envs), nothing, nothing, {"is_success": infos["is_success"]}
        stepped = super().step(commands)
        self._seen = stepped[0], stepped[-1]
        return stepped

    @property
    def _max_episode_steps(self) -> int:
        """Most steps of the episodes now being played; LeRobot asks after every reset."""
        frames = super()._max_episode_steps
        return frames if self._inference is None else self._inference.calls(frames)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy is made from: the log and the arguments of ``DynahoiVectorEnv``."""
        state = super().__getstate__()
        options = {name: value for name, value in state["options"].items() if name != "on_episode"}
        return state | {"options": options | {"log": self._log, "inference": copy.deepcopy(self._inference)}}

    def close_extras(self, **kwargs: Any) -> None:
        """Write what has been played so far."""
        self._log.write()
