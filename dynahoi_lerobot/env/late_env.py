"""Worlds that move on while the policy that is asked for actions infers."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np

from dynahoi_lerobot.env.vector_env import ONE_EPISODE_OPTION, DynahoiVectorEnv
from dynahoi_lerobot.rollout.stepwise_inference import StepwiseInference


class LateVectorEnv(DynahoiVectorEnv):
    """A vector env whose steps are calls of a policy, one inference at a time.

    After some calls the world stands still: the observation is the one before, and nothing ends. Without a timing it
    is a ``DynahoiVectorEnv``.
    """

    def __init__(self, num_envs: int = 1, *, inference: StepwiseInference | None = None, **options: Any) -> None:
        """Take the timing, which is no other env's, and the arguments of ``DynahoiVectorEnv``."""
        super().__init__(num_envs, **options)
        self._inference = inference

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
        """Return what a copy is made from: the arguments of the constructor."""
        state = super().__getstate__()
        return state | {"options": state["options"] | {"inference": copy.deepcopy(self._inference)}}
