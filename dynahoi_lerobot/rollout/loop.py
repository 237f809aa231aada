"""Playing: worlds that are observed, moved and recorded frame by frame.

Generation, evaluation and the environments all play here, so that they cannot drift apart.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from dynahoi_lerobot.core.agent import Actor, Agent, Meeting, Observation, WorldState
from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.recorder import Job, WorldRecorder, measure_frame
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.rollout.teacher_labels import Labeled
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

DEFAULT_BATCH = 32
"""Worlds played side by side. A network's rounding may depend on what else is in its batch, so a
policy that is recorded plays consecutive seeds of a shard together, whoever records them."""


class Session:
    """Some of the worlds of a batch, each in the middle of its job.

    Attributes:
        batch: the worlds.
        observation: the last observation of all worlds.
    """

    def __init__(
        self, batch: WorldBatch, *, record_images: bool = True, render_later: bool = False
    ) -> None:
        """Play in ``batch``; episodes keep what was rendered, or are rendered at their end if it
        ``render_later``.
        """
        self.batch = batch
        self.record_images = record_images
        self._render_later = render_later
        self.observation: Observation | None = None
        self._recorders: dict[int, WorldRecorder] = {}

    @property
    def playing(self) -> np.ndarray:
        """(n,) sorted worlds that play."""
        return np.array(sorted(self._recorders), int)

    @property
    def idle(self) -> np.ndarray:
        """(m,) sorted worlds that do not."""
        return np.array([i for i in range(self.batch.size) if i not in self._recorders], int)

    def begin(self, ids: Sequence[int] | np.ndarray, jobs: Sequence[Job]) -> None:
        """Begin a job in each of the sorted worlds ``ids``; what was played there is dropped."""
        self.batch.reset(ids, [job.spec for job in jobs], [job.attempt for job in jobs])
        self._recorders.update(
            (int(i), WorldRecorder(job)) for i, job in zip(ids, jobs, strict=True)
        )

    def observe(self, *, images: bool = True, ending: np.ndarray | None = None) -> Observation:
        """Return what is seen of all worlds; only worlds that play, and ``ending`` (n,), are
        rendered.
        """
        shown = self.playing if ending is None else np.union1d(self.playing, ending)
        self.observation = self.batch.observe(images=images, ids=shown)
        return self.observation

    def step(
        self,
        commands: np.ndarray,
        labels: np.ndarray | None = None,
        control_mode: str | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Record what was observed, and move the worlds that play by one frame.

        Args:
            commands: (N, 18), or (N, 4) in control mode ``grasp``, of all worlds; the rows of
                worlds that do not play are ignored.
            labels: (N, 18) commands that a teacher wants at this frame; None without a teacher.
            control_mode: of the commands; by default the rules' own.

        Returns:
            (N,) bool each: worlds in which the capture rule has settled the outcome, and others
            that have reached their longest length.

        Raises:
            ValueError: for a wrong shape or a value that is not finite; nothing has moved then.
        """
        assert self.observation is not None, "observe before the first step"
        ids = self.playing
        columns = measure_frame(self.batch, self.observation, ids)
        images = self.observation.images if self.record_images else {}
        self.batch.step(commands, ids, control_mode)
        given = self.batch.given[ids]
        if labels is None:
            wanted = given
        else:
            wanted = self.batch.commands.labels(labels, self.observation.state)[ids]
        columns |= {
            "action": wanted,
            "given_action": given,
            "executed_action": self.batch.executed[ids],
        }
        terminated, full = np.zeros((2, self.batch.size), bool)
        for row, i in enumerate(ids):
            recorder = self._recorders[i]
            frame = {name: values[row] for name, values in columns.items()}
            recorder.add(frame, {view: pixels[i] for view, pixels in images.items()})
            terminated[i] = recorder.settled(self.batch.rule)
            full[i] = recorder.full
        return terminated, full & ~terminated

    def world_state(self, observation: Observation) -> WorldState:
        """Return what an expert sees, of the worlds that play."""
        return self.batch.world_state(observation, self.playing)

    def success(self, i: int) -> bool:
        """Return the verdict on what world ``i`` has played so far."""
        return self._recorders[i].success(self.batch.rule)

    def job(self, i: int) -> Job:
        """Return what world ``i`` plays."""
        return self._recorders[i].job

    def finish(
        self, i: int, actor: str, meeting: Meeting | None = None, *, again: bool = False
    ) -> Episode:
        """End the episode of world ``i`` and return the recording, which names the actor and has
        its plan, if any.

        If a failed episode is played ``again``, its images need not be rendered.
        """
        recorder = self._recorders.pop(i)
        episode = recorder.freeze(self.batch, i, actor, meeting)
        if not self._render_later or (again and not episode.success):
            return episode
        return replace(episode, images=self.batch.images_of(i, recorder.visual_states))


def play(
    batch: WorldBatch,
    actor: Actor,
    jobs: Iterable[Job],
    *,
    images: bool = False,
    retry: bool = False,
) -> Iterator[tuple[Job, Episode]]:
    """Play jobs in the worlds of ``batch`` and yield each with its episode, as they end.

    A world that finishes begins the next job at once, unless the actor has memory: then it gets the
    next jobs together, after ``reset``.

    Args:
        batch: the worlds.
        actor: who moves the hands.
        jobs: consumed lazily.
        images: whether to record images even if the actor asks for none.
        retry: play jobs that fail again, before any other, as often as the actor may.

    Raises:
        ValueError: if the actor needs images and the rules have no camera.
    """
    if actor.sees_images and not batch.rules.image_size:
        raise ValueError(f"{actor.name!r} needs images, and image_size is 0, no camera")
    later = images and not actor.sees_images and batch.renders_later
    session = Session(batch, render_later=later)
    fresh = iter(jobs)
    again = deque[Job]()
    while True:
        if not (actor.has_memory and session.playing.size):
            _begin(session, actor, again, fresh)
        if not session.playing.size:
            return
        observation = session.observe(images=(images or actor.sees_images) and not later)
        commands = actor.commands(observation, session.world_state)
        terminated, truncated = session.step(commands, actor.labels, actor.control_mode)
        ended = np.flatnonzero(terminated | truncated)
        if ended.size and actor.has_memory:  # others begin again
            actor.leave(ended)
        for i in ended:
            job = session.job(int(i))
            meeting = actor.first_meeting(job.spec, batch.control)
            may_retry = retry and job.attempt <= actor.retries
            episode = session.finish(int(i), actor.name, meeting, again=may_retry)
            if may_retry and not episode.success:
                again.append(replace(job, attempt=job.attempt + 1))
            else:
                yield job, episode


def record(
    recording: Recording,
    seeds: Sequence[int],
    *,
    batch_size: int = DEFAULT_BATCH,
    threads: int = 0,
    images: bool = True,
) -> Iterator[Episode]:
    """Yield the expert's successful episodes, in the order of ``seeds``; those it never manages are
    left out.

    With ``keep_failures`` the last attempt at them is yielded instead. Each frame's
    ``action`` is the expert's label, see `teacher_labels`; an episode ends soon after its outcome.
    Each is a function of (recording, seed): batch size and threads do not matter.
    """
    recipe = recording.recipe
    batch = WorldBatch(recipe.rules, min(batch_size, max(1, len(seeds))), threads)
    expert = EXPERTS[recording.expert_name]()
    demonstrator = Labeled(expert, perturbed_share=recording.perturbed_share)
    jobs = _fresh_jobs(recipe, seeds, threads)
    for episode in _in_order(play(batch, demonstrator, jobs, images=images, retry=True)):
        if episode.success or recording.keep_failures:
            yield episode


def record_on_policy(
    recording: Recording,
    seeds: Sequence[int],
    *,
    make_agent: Callable[[int], Agent],
    threads: int = 0,
    images: bool = True,
) -> Iterator[Episode]:
    """Yield the episodes of ``seeds`` in their order, including failed ones.

    Args:
        recording: with an ``actor``, whose states its expert labels.
        seeds: of the episodes; what a policy does may depend, in the last bit, on which are played
            in a group.
        make_agent: returns the policy that the recording names, whose random numbers follow from
            the seed given.
        threads: for physics, 0 for all cores; without influence on the result.
        images: whether to record the views of the rules.
    """
    for first in range(0, len(seeds), DEFAULT_BATCH):
        group = seeds[first : first + DEFAULT_BATCH]
        agent = Labeled(recording.teacher(), make_agent(group[0]), name=recording.actor)
        jobs = _fresh_jobs(recording.recipe, group, threads)
        batch = WorldBatch(recording.recipe.rules, len(group), threads)
        yield from _in_order(play(batch, agent, jobs, images=images))


def _in_order(played: Iterable[tuple[Job, Episode]]) -> Iterator[Episode]:
    """Yield episodes in the order of their jobs, each as soon as all before it have ended."""
    finished: dict[int, Episode] = {}
    next_index = 0
    for job, episode in played:
        finished[job.index] = episode
        while next_index in finished:
            yield finished.pop(next_index)
            next_index += 1


def evaluate(
    batch: WorldBatch, actor: Actor, specs: Sequence[EpisodeSpec], *, images: bool = False
) -> Iterator[Episode]:
    """Yield one evaluated episode per spec, as they end: the window, then up to L control steps.

    The frame after the last step is recorded as well, as its outcome; what is commanded there has
    none. An expert that may try again does so here as well; ``meta.attempts`` says how often it had
    to.
    """
    jobs = (Job.evaluation(i, spec) for i, spec in enumerate(specs))
    for _, episode in play(batch, actor, jobs, images=images, retry=True):
        yield episode


def _fresh_jobs(recipe: Recipe, seeds: Sequence[int], threads: int) -> Iterator[Job]:
    for block in range(0, len(seeds), DEFAULT_BATCH):
        specs = sample_specs(recipe, seeds[block : block + DEFAULT_BATCH], threads=threads)
        yield from (Job.evaluation(block + offset, spec) for offset, spec in enumerate(specs))


def _begin(session: Session, actor: Actor, again: deque[Job], fresh: Iterator[Job]) -> None:
    """Give every idle world a job, as long as there are any: first those to be played ``again``,
    then fresh ones.
    """
    idle = session.idle
    jobs = [again.popleft() for _ in idle[: len(again)]]
    jobs += islice(fresh, len(idle) - len(jobs))
    if jobs:
        session.begin(idle[: len(jobs)], jobs)
        actor.reset(session.batch.size)


# -- again, from the seed alone or by stored actions in the world that the seed describes ----------


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


class Replayer(Agent):
    """Repeats given commands, one log a world, whatever it sees."""

    name = "player"
    control_mode = JOINTS

    def __init__(self, logs: Sequence[ActionLog], *, sees_images: bool = False) -> None:
        """Repeat ``logs``; with ``sees_images`` every frame is drawn when it is played, as in the
        environment.
        """
        self._logs = logs
        self.sees_images = sees_images
        self._frame = 0

    def reset(self, count: int) -> None:
        """Start from the first command."""
        self._frame = 0

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18), the next command of each world, the last one where a log is over."""
        commands = [log.actions[min(self._frame, len(log.actions) - 1)] for log in self._logs]
        self._frame += 1
        return np.stack(commands).astype(np.float64)


def played_again(recording: Recording, recorded: Episode) -> Episode | None:
    """Return what recording the episode's seed gives now; None if the expert does not manage it.

    Nothing but its seed matters, or in an on-policy recording the commands given, in the policy's
    place. The images come from an environment that executes the commands, so that a recording that
    shows something else is found.
    """
    seed = recorded.meta.seed
    if recording.actor:
        replayer = Replayer([ActionLog(seed, recorded.given_action)])
        made = next(
            record_on_policy(recording, [seed], make_agent=lambda _: replayer, images=False)
        )
    else:
        made = next(record(recording, [seed], images=False), None)
    if made is None:
        return None
    (shown,) = replay(recording.recipe, [ActionLog(seed, made.given_action, made.meta.attempts)])
    return replace(made, images=shown.images)


def replay(
    recipe: Recipe, logs: Sequence[ActionLog], *, images: bool = True, as_evaluated: bool = False
) -> list[Episode]:
    """Return the episodes that logged commands lead to, played again from their seeds, in the order
    of the logs.

    Args:
        recipe: the episodes that were played.
        logs: one an episode; all are played side by side.
        images: whether to draw the views of the rules, if there are any, frame by frame.
        as_evaluated: whether an episode ends when an evaluation ends it, before a log that
            continues and after one that stops; by default it ends with its log.
    """
    specs = sample_specs(recipe, [log.seed for log in logs])
    jobs = [
        Job.evaluation(i, spec, log.attempt)
        if as_evaluated
        else Job(i, spec, len(log.actions), log.attempt)
        for i, (spec, log) in enumerate(zip(specs, logs, strict=True))
    ]
    replayer = Replayer(logs, sees_images=images and recipe.rules.image_size > 0)
    played = play(WorldBatch(recipe.rules, len(logs)), replayer, jobs)
    return [episode for _, episode in sorted(played, key=lambda pair: pair[0].index)]
