"""Attributes of every world at once, as gymnasium's other vector envs answer for them and LeRobot asks."""

from __future__ import annotations

from typing import Any

from gymnasium.vector import VectorEnv

from dynahoi_lerobot.env.running_episodes import RunningEpisodes
from dynahoi_lerobot.world.batch import WorldBatch


class SharedAttributes(VectorEnv):
    """A vector env whose worlds are rows of one batch: what is asked of each is known here.

    Attributes:
        kind: the kind of motion that is played, None for all.
    """

    kind: str | None
    _batch: WorldBatch
    _episodes: RunningEpisodes

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return attribute ``name`` of every world, called if it can be; as gymnasium's other vector envs do."""
        value = getattr(self, name)
        if name == "render":
            return value()
        result = value(*args, **kwargs) if callable(value) else value
        return tuple(result) if isinstance(result, list) else (result,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return attribute ``name`` of every world."""
        return self.call(name)

    @property
    def task(self) -> str:
        """The kind of motion, or ``all``."""
        return self.kind or "all"

    @property
    def task_description(self) -> list[str]:
        """The instruction of every world."""
        return ["" if spec is None else spec.task for spec in self._batch.specs]

    @property
    def _max_episode_steps(self) -> int:
        """Longest episode now being played [frames]; LeRobot asks after every reset."""
        return int(self._episodes.longest.max())
