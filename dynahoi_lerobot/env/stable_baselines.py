"""Our vector environments as Stable-Baselines3's, which refuses Gymnasium's.

This module imports Stable-Baselines3, which brings torch.
"""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv


class Worlds(VecEnv):
    """N worlds whose observations are flat vectors.

    An episode's last ``info`` has ``terminal_observation``, ``TimeLimit.truncated`` and every
    metric; seeds mean the same as in ``DynahoiVectorEnv.reset``.

    Args:
        env: a ``DynahoiVectorEnv`` without a camera (``image_size=0``), wrapped or not, in the
            autoreset mode ``SameStep``, which Stable-Baselines3 expects.

    Raises:
        ValueError: in another autoreset mode, or with images.
    """

    def __init__(self, env: VectorEnv) -> None:
        mode = env.metadata["autoreset_mode"]
        space = env.single_observation_space
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode must be 'SameStep', got {mode.value!r}")
        if not isinstance(space, spaces.Dict) or "pixels" in space.spaces:
            raise ValueError("the environment must have no camera; make it with image_size=0")
        self._env = env
        self._keys = list(space.spaces)
        self._seed: int | None = None
        self._actions = np.zeros(0)
        super().__init__(env.num_envs, spaces.flatten_space(space), env.single_action_space)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Let the next ``reset`` begin with the episodes ``seed``, ``seed`` + 1, ...; random ones
        if None.
        """
        self._seed = seed
        return [None if seed is None else seed + i for i in range(self.num_envs)]

    def reset(self) -> np.ndarray:
        """Begin an episode in every world; return the observations (N, D)."""
        observation, _ = self._env.reset(seed=self._seed)
        self._seed = None
        return self._flat(observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions (N, A) of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step; return observations (N, D), rewards (N,), whether an episode ended (N,), infos."""
        observation, rewards, terminated, truncated, info = self._env.step(self._actions)
        ended = terminated | truncated
        infos = [{"is_success": bool(success)} for success in info["is_success"]]
        for i in np.flatnonzero(ended):
            final = info["final_info"]
            names = [name for name in final if not name.startswith("_")]
            infos[i] = {name: final[name][i].item() for name in names}
            infos[i]["terminal_observation"] = self._flat(info["final_obs"][i])
            infos[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
        return self._flat(observation), rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        """End the use of the environment."""
        self._env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the worlds, which is the same for all."""
        value = getattr(self._env.unwrapped, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: the worlds share one batch."""
        raise NotImplementedError(f"cannot set {attr_name!r}: the worlds share one batch")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list:
        """Refuse: the worlds share one batch."""
        raise NotImplementedError(f"cannot call {method_name!r}: the worlds share one batch")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for every world: no wrapper of single environments is around it."""
        return [False for _ in self._get_indices(indices)]

    def _flat(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        return np.concatenate([observation[key] for key in self._keys], axis=-1)
