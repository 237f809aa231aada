"""On-policy recordings: a policy moves the hand, and in every frame a teacher says what it would have commanded.

A share of the episodes is led by the teacher itself, whose commands are disturbed (DAgger; Ross et al., 2011).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynahoi_lerobot.core.agent import Agent, Observation
from dynahoi_lerobot.core.conventions import CONTROL_DT, HAND_DOF, PALM_DOF
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts.base import Teacher
from dynahoi_lerobot.rollout.loop import Session, check_sight, sample_shortened
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.world.batch import WorldBatch
from dynahoi_lerobot.world.commands import DISTURBED_SHARE

GROUP = 32
"""Episodes that a policy plays side by side. A network's rounding may depend on what else is in its batch, so groups
are consecutive seeds of a shard, whoever records them."""
DISTURBANCE_M = 0.03
"""Standard deviation of what the palm of a teacher that leads is disturbed by, along each axis [m]."""
STREAM = 0x1EAD

MakeAgent = Callable[[int], Agent]
"""Returns the policy, whose random numbers follow from the seed given."""


@dataclass(frozen=True, eq=False)
class Lead:
    """Whether a teacher leads an episode, and how it is disturbed there: both follow from the episode's seed.

    Attributes:
        led: the teacher leads.
        rng: of the disturbances.
    """

    led: bool
    rng: np.random.Generator

    @classmethod
    def drawn(cls, seed: int, teacher_share: float) -> Lead:
        """Draw it for the episode of a seed, of which the teacher leads a share."""
        rng = np.random.default_rng([STREAM, seed])
        return cls(bool(rng.random() < teacher_share), rng)


def record_on_policy(
    recipe: Recipe, seeds: Sequence[int], *, make_agent: MakeAgent | None, threads: int = 0
) -> Iterator[Episode]:
    """Yield the episodes of ``seeds`` in their order, those that the policy fails included.

    Args:
        recipe: with an ``actor``, or a teacher that leads everything.
        seeds: of the episodes; what a policy does may depend, in the last bit, on which are played in a group.
        make_agent: returns the policy that the recipe names; None if the teacher leads all.
        threads: for physics, 0 for all cores; without influence on the result.
    """
    for first in range(0, len(seeds), GROUP):
        specs = sample_shortened(recipe, seeds[first : first + GROUP], threads)
        agent = None if make_agent is None else make_agent(seeds[first])
        yield from play_on_policy(WorldBatch(recipe, len(specs), threads), agent, specs)


def play_on_policy(batch: WorldBatch, agent: Agent | None, specs: Sequence[EpisodeSpec]) -> list[Episode]:
    """Play one episode in every world of a batch; return the labelled recordings, in the order of ``specs``.

    Args:
        batch: the worlds; their recipe names the teacher and the policy, and the share that the former leads.
        agent: moves the hands where the teacher does not lead; None if it leads all.
        specs: an episode for each world.

    Raises:
        ValueError: if the agent needs images and the recipe has no camera.
    """
    recipe = batch.recipe
    session, teacher = Session(batch), recipe.teacher()
    session.begin(np.arange(batch.size), [Job.evaluation(i, spec) for i, spec in enumerate(specs)])
    if agent is not None:
        check_sight(agent, recipe)
        agent.reset(batch.size)
    leads = [Lead.drawn(spec.seed, recipe.teacher_share) for spec in specs]
    led = np.array([lead.led for lead in leads])
    played: dict[int, Episode] = {}
    while session.playing.size:
        observation = session.observe()
        labels = _labels(batch, teacher, observation) | {"intervention": led}
        stray = np.stack([disturbance(lead.rng) for lead in leads])
        commands = labels["action"] + stray
        if agent is not None:
            commands = np.where(led[:, None], commands, agent.act(observation))
        for i in session.step(commands, labels).worlds:
            job = session.job(int(i))
            meeting = teacher.first_meeting(job.spec, batch.control, job.attempt) if led[i] else None
            episode = session.finish(int(i), teacher.name if led[i] else recipe.actor, meeting)
            played[int(i)] = replace(episode, meta=replace(episode.meta, actor=recipe.actor))
    return [played[i] for i in range(batch.size)]


def disturbance(rng: np.random.Generator) -> np.ndarray:
    """Draw (18,) by how much a command of the teacher is changed: its palm [m], in some of the frames."""
    stray = np.zeros(HAND_DOF)
    if rng.random() < DISTURBED_SHARE:
        stray[:PALM_DOF] = rng.normal(0.0, DISTURBANCE_M, PALM_DOF)
    return stray


def _labels(batch: WorldBatch, teacher: Teacher, observation: Observation) -> dict[str, np.ndarray]:
    """What the teacher says of this frame of all N worlds, (N, ...) each, by name in ``Episode``."""
    world = batch.world_state(observation)
    return {"action": batch.accepted(teacher.act(world)), "teacher_arrival": teacher.arrivals(world) * CONTROL_DT}
