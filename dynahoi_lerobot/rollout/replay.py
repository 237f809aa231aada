"""Make an episode again: from its seed alone, or by stored actions in the world that the seed describes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.agent import Agent, Observation
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.rollout.loop import Job, play, record, record_on_policy
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch


@dataclass(frozen=True, eq=False)
class ActionLog:
    """The commands that one episode was played with.

    Attributes:
        seed: of the episode.
        actions: (T, 18) palm positions [m], home frame, and joint angles [rad].
        attempt: the try that was recorded.
    """

    seed: int
    actions: np.ndarray
    attempt: int = 1


class Player(Agent):
    """Repeats given commands, those of one log a world, and looks at nothing."""

    name = "player"

    def __init__(self, logs: Sequence[ActionLog]) -> None:
        self._logs = logs
        self._frame = 0

    def reset(self, count: int) -> None:
        """Start from the first command."""
        self._frame = 0

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18), the next command of each world, the last one where a log is over."""
        commands = [log.actions[min(self._frame, len(log.actions) - 1)] for log in self._logs]
        self._frame += 1
        return np.stack(commands).astype(np.float64)


def played_again(recipe: Recipe, recorded: Episode) -> Episode | None:
    """Return what recording the episode's seed gives now; None if the expert does not manage it.

    Nothing but its seed matters, or in an on-policy recording the executed commands, in the policy's place.
    """
    seed = recorded.meta.seed
    if not recipe.actor:
        return next(record(recipe, [seed]), None)
    player = Player([ActionLog(seed, recorded.executed_action)])
    return next(record_on_policy(recipe, [seed], make_agent=lambda _: player, threads=1))


def replay(
    recipe: Recipe, logs: Sequence[ActionLog], *, images: bool = True, as_evaluated: bool = False
) -> list[Episode]:
    """Return the episodes that logged commands lead to, played again from their seeds, in the order of the logs.

    Args:
        recipe: what was played.
        logs: one an episode; all are played side by side.
        images: whether to record images.
        as_evaluated: whether an episode ends when an evaluation ends it, before a log that continues and after one that
            stops; by default it ends with its log.
    """
    specs = sample_specs(recipe, [log.seed for log in logs])
    jobs = [
        Job.evaluation(i, spec, log.attempt) if as_evaluated else Job(i, spec, len(log.actions), log.attempt)
        for i, (spec, log) in enumerate(zip(specs, logs, strict=True))
    ]
    played = play(WorldBatch(recipe, len(logs)), Player(logs), jobs, images=images)
    return [episode for _, episode in sorted(played, key=lambda pair: pair[0].index)]
