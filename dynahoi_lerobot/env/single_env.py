"""One world as a ``gymnasium.Env``: a vector environment of one."""

from typing import Any

import gymnasium as gym
import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.env import vector_env


class DynahoiEnv(gym.Env):
    """One hand and one moving object: ``DynahoiVectorEnv`` for a single world, without batch axis and autoreset.

    Description, observation, action, reward, episode end, info and options are those of ``DynahoiVectorEnv``. After
    the end of an episode the world stands still until ``reset``. Copies (``pickle``, ``deepcopy``) have the same
    constructor arguments and begin before their first reset.
    """

    metadata = {"render_modes": list(vector_env.RENDER_MODES), "render_fps": CONTROL_HZ}  # noqa: RUF012 - gymnasium's convention

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        """Take the keyword arguments of ``DynahoiVectorEnv`` besides ``num_envs``.

        Raises:
            ValueError: for an unknown render mode or an unknown name, naming those there are.
        """
        self._options = {"render_mode": render_mode, **options}
        self._vector = vector_env.DynahoiVectorEnv(1, **self._options)
        self.render_mode = render_mode
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: number of the episode within the split (and kind), 0 to 2^40 - 1; None draws one.
            options: none are known.

        Raises:
            ValueError: for a seed that is not such an integer.
            ClosedEnvironmentError: after ``close``.
        """
        number = None if seed is None else vector_env.check_seed(seed)
        super().reset(seed=number)
        if number is None:
            number = int(self.np_random.integers(0, vector_env.RANDOM_SEED_LIMIT))
        observation, infos = self._vector.reset(seed=[number], options={vector_env.ONE_EPISODE_OPTION: True})
        return _first(observation), _first(infos)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance by one frame of 0.05 s.

        Args:
            action: (18,) target for the next frame, palm centre [m], home frame, and joint angles [rad].

        Raises:
            ValueError: for a wrong shape or element type, or a value that is not finite; nothing moves then.
            ResetNeeded: before the first ``reset``.
            ClosedEnvironmentError: after ``close``.
        """
        observation, reward, terminated, truncated, infos = self._vector.step(np.asarray(action)[None])
        return _first(observation), float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first(infos)

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Return the image of the hand's camera, (H, W, 3) uint8, or None if the render mode is None."""
        return self._vector.render()[0] if self.render_mode is not None else None

    def close(self) -> None:
        """End the use of the environment; closing it again has no effect."""
        self._vector.close()

    @property
    def task_description(self) -> str:
        """The instruction."""
        return self._vector.task_description[0]

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy is made from: the constructor's arguments."""
        return {"options": self._options, "spec": self.spec}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Construct the copy."""
        self.__init__(**state["options"])
        self.spec = state["spec"]


def _first(batched: dict[str, Any]) -> dict[str, Any]:
    return {key: _first(value) if isinstance(value, dict) else value[0] for key, value in batched.items()}
