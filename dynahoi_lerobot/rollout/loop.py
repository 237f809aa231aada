"""Playing many episodes with one actor: what generation and evaluation share, so that they cannot drift apart."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from dynahoi_lerobot.agent import Actor
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.rollout.session import Session
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

DEFAULT_BATCH = 32


def play(
    batch: WorldBatch, actor: Actor, jobs: Iterable[Job], *, images: bool = False
) -> Iterator[tuple[Job, Episode]]:
    """Play jobs in the worlds of ``batch`` and yield each with its episode, as they end.

    A world that finishes begins the next job at once, unless the actor has memory: then it gets the next jobs together,
    after ``reset``.

    Args:
        batch: the worlds.
        actor: who moves the hands.
        jobs: consumed lazily.
        images: whether to record images even if the actor asks for none.

    Raises:
        ValueError: if the actor needs images and the recipe has no camera.
    """
    if actor.sees_images and not batch.recipe.image_size:
        raise ValueError(f"{actor.name!r} needs images, and the recipe's image_size is 0, no camera")
    session, waiting = Session(batch), iter(jobs)
    while True:
        if not (actor.has_memory and session.playing.size):
            _begin(session, actor, waiting)
        if not session.playing.size:
            return
        observation = session.observe(images=images or actor.sees_images)
        ended = session.step(actor.commands(observation, batch.world_state))
        for i in ended.worlds:
            job = session.job(int(i))
            yield job, session.finish(int(i), actor.name, actor.first_meeting(job.spec, batch.control, job.attempt))


def record(
    recipe: Recipe, seeds: Sequence[int], *, batch_size: int = DEFAULT_BATCH, threads: int = 0
) -> Iterator[Episode]:
    """Yield the expert's successful episodes, in the order of ``seeds``; those it never manages are left out.

    With ``recipe.keep_failures`` the last attempt at them is yielded instead.

    Each is a function of (recipe, seed): batch size and threads do not matter.
    """
    batch = WorldBatch(recipe, min(batch_size, max(1, len(seeds))), threads)
    finished: dict[int, Episode] = {}
    next_index = 0
    expert, jobs = EXPERTS[recipe.expert](), _fresh_jobs(recipe, seeds, threads)
    for job, episode in _play_with_retries(batch, expert, jobs, images=True):
        finished[job.index] = episode
        while next_index in finished:
            ready = finished.pop(next_index)
            next_index += 1
            if ready.success or recipe.keep_failures:
                yield ready


def evaluate(
    batch: WorldBatch, actor: Actor, specs: Sequence[EpisodeSpec], *, images: bool = False
) -> Iterator[Episode]:
    """Yield one evaluated episode per spec, as they end: the window, then up to L control steps.

    The frame after the last step is recorded as well, as its outcome; what is commanded there has none.

    An expert that may try again does so here as well; ``meta.attempts`` says how often it had to.
    """
    jobs = (Job.evaluation(i, spec) for i, spec in enumerate(specs))
    for _, episode in _play_with_retries(batch, actor, jobs, images=images):
        yield episode


def _play_with_retries(
    batch: WorldBatch, actor: Actor, fresh: Iterator[Job], *, images: bool
) -> Iterator[tuple[Job, Episode]]:
    """Play jobs as ``play`` does, but those that fail again, for as long as the actor may retry."""
    jobs = _Jobs(fresh)
    attempts = 1 + actor.retries
    for job, episode in play(batch, actor, jobs, images=images):
        if episode.success or job.attempt == attempts:
            yield job, episode
        else:
            jobs.retries.append(replace(job, attempt=job.attempt + 1))


class _Jobs(Iterator[Job]):
    """Retries as they come up, then fresh jobs.

    Unlike a generator it can be asked again after it had nothing: the last episodes to end may still ask for retries.
    """

    def __init__(self, fresh: Iterator[Job]) -> None:
        self.retries, self._fresh = deque[Job](), fresh

    def __next__(self) -> Job:
        return self.retries.popleft() if self.retries else next(self._fresh)


def _fresh_jobs(recipe: Recipe, seeds: Sequence[int], threads: int) -> Iterator[Job]:
    for block in range(0, len(seeds), DEFAULT_BATCH):
        specs = sample_shortened(recipe, seeds[block : block + DEFAULT_BATCH], threads)
        yield from (Job(block + offset, spec, spec.length_frames) for offset, spec in enumerate(specs))


def sample_shortened(recipe: Recipe, seeds: Sequence[int], threads: int) -> list[EpisodeSpec]:
    """Return the episodes of ``seeds`` as they are recorded: over ``recipe.hold_frames`` after the intercept."""
    return [_shortened(spec, recipe.hold_frames) for spec in sample_specs(recipe, seeds, threads=threads)]


def _shortened(spec: EpisodeSpec, hold_frames: int | None) -> EpisodeSpec:
    """The same episode, over ``hold_frames`` after the intercept."""
    if hold_frames is None:
        return spec
    return replace(spec, length_frames=min(spec.length_frames, spec.intercept_frame + 1 + hold_frames))


def _begin(session: Session, actor: Actor, waiting: Iterator[Job]) -> None:
    """Give every idle world a job, as long as there are any."""
    idle = np.setdiff1d(np.arange(session.batch.size), session.playing)
    begun = list(zip(idle, waiting, strict=False))
    if begun:
        session.begin([i for i, _ in begun], [job for _, job in begun])
        actor.reset(session.batch.size)
