"""The one loop. Generation and evaluation both run it, so they cannot drift apart."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from dynahoi_lerobot.agent import Agent, Expert
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.recorder import Job, WorldRecorder, frame_columns
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

DEFAULT_BATCH = 32


def play(
    batch: WorldBatch, actor: Agent | Expert, jobs: Iterable[Job], *, images: bool = False
) -> Iterator[tuple[Job, Episode]]:
    """Play jobs in the worlds of ``batch`` and yield each with its episode, as they end.

    An expert has no memory, so a world that finishes begins the next job at once. An agent may have some, so it gets
    the next jobs together, after ``reset``.

    Args:
        batch: the worlds.
        actor: who moves the hands.
        jobs: consumed lazily.
        images: whether to record images even if the actor asks for none.
    """
    waiting, running = iter(jobs), dict[int, WorldRecorder]()
    look = images or getattr(actor, "sees_images", False)
    while True:
        if isinstance(actor, Expert) or not running:
            _begin(batch, actor, waiting, running)
        if not running:
            return
        ids = np.array(sorted(running))
        _step(batch, actor, ids, running, look=look)
        for i in ids:
            if running[i].full() or running[i].settled_at(batch.rule.settle_frames):
                recorder = running.pop(int(i))
                yield recorder.job, recorder.freeze(batch.rule, actor.name)


def record(
    recipe: Recipe, seeds: Sequence[int], *, batch_size: int = DEFAULT_BATCH, threads: int = 0, images: bool = True
) -> Iterator[Episode]:
    """Yield the expert's successful episodes, in the order of ``seeds``; those it never manages are left out.

    Each is a function of (recipe, seed): batch size and threads do not matter.
    """
    batch = make_batch(recipe, min(batch_size, max(1, len(seeds))), threads)
    finished: dict[int, Episode] = {}
    next_index = 0
    expert, jobs = EXPERTS[recipe.expert](), _fresh_jobs(recipe, seeds, threads)
    for job, episode in _play_with_retries(batch, expert, jobs, images):
        finished[job.index] = episode
        while next_index in finished:
            ready = finished.pop(next_index)
            next_index += 1
            if ready.success:
                yield ready


def evaluate(
    batch: WorldBatch, actor: Agent | Expert, specs: Sequence[EpisodeSpec], *, images: bool = False
) -> Iterator[Episode]:
    """Yield one evaluated episode per spec, as they end: the window, then up to L control steps.

    An expert that may try again does so here as well; ``meta.attempts`` says how often it had to.
    """
    jobs = (Job.evaluation(i, spec) for i, spec in enumerate(specs))
    for _, episode in _play_with_retries(batch, actor, jobs, images):
        yield episode


def make_batch(recipe: Recipe, size: int, threads: int = 0) -> WorldBatch:
    """Return a batch that plays ``recipe``."""
    return WorldBatch(
        size,
        capture=recipe.capture,
        hand=recipe.hand,
        image_size=recipe.image_size,
        views=recipe.views,
        renderer=recipe.renderer,
        threads=threads,
        disturbance_m=recipe.disturbance_m,
    )


def _play_with_retries(
    batch: WorldBatch, actor: Agent | Expert, fresh: Iterator[Job], images: bool
) -> Iterator[tuple[Job, Episode]]:
    """Play jobs as ``play`` does, but those that fail again, for as long as the actor may retry."""
    jobs = _Jobs(fresh)
    attempts = 1 + getattr(actor, "retries", 0)
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
        specs = sample_specs(recipe, seeds[block : block + DEFAULT_BATCH], threads=threads)
        for offset, drawn in enumerate(specs):
            spec = _shortened(drawn, recipe.hold_frames)
            yield Job(block + offset, spec, spec.length_frames)


def _shortened(spec: EpisodeSpec, hold_frames: int | None) -> EpisodeSpec:
    """The same episode, over ``hold_frames`` after the intercept."""
    if hold_frames is None:
        return spec
    return replace(spec, length_frames=min(spec.length_frames, spec.intercept_frame + 1 + hold_frames))


def _begin(batch: WorldBatch, actor: Agent | Expert, waiting: Iterator[Job], running: dict[int, WorldRecorder]) -> None:
    """Give every idle world a job, as long as there are any."""
    idle = [i for i in range(batch.size) if i not in running]
    begun = list(zip(idle, waiting, strict=False))
    if not begun:
        return
    batch.reset([i for i, _ in begun], [job.spec for _, job in begun], [job.attempt for _, job in begun])
    running.update((i, WorldRecorder(job)) for i, job in begun)
    if isinstance(actor, Agent):
        actor.reset(batch.size)


def _step(
    batch: WorldBatch, actor: Agent | Expert, ids: np.ndarray, running: dict[int, WorldRecorder], *, look: bool
) -> None:
    """Observe, act and advance the worlds ``ids`` by one frame, recording each."""
    observation = batch.observe(images=look, ids=ids)
    commands = actor.act(batch.world_state(observation)) if isinstance(actor, Expert) else actor.act(observation)
    columns = frame_columns(batch, observation)
    for i in ids:
        running[i].see(columns, i, observation.images)
    batch.step(commands[ids], ids)
    for i in ids:
        running[i].act(batch.executed[i])
