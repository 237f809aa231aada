"""One round: a student moves the hands of many worlds, and a teacher says what it would have done in every frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.conventions import PALM_DOF
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.rules import is_acting
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.onpolicy.student import Student
from dynahoi_lerobot.rollout.loop import Session
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.world.batch import WorldBatch

DISTURBANCE_M, DISTURBED_SHARE = 0.03, 0.3
"""A teacher that leads misses its command in so many of the frames, by this standard deviation along each axis [m]."""


@dataclass(frozen=True, eq=False)
class Round:
    """B episodes of up to T frames, with the teacher's labels. Home frame, SI units.

    Attributes:
        state: (B, T, 18) float32, palm centre [m] and joint angles [rad].
        watching: (B, T) bool, the observation window.
        playing: (B, T) bool, False once an episode has ended.
        released: (B, T) bool, the hand has caught or touched the target, which keeps to its path no more.
        target: (B, T, 3) float32, its position [m].
        path: B arrays (F, 3) float32, the untouched target's position at every frame [m].
        closed: (B, 15) float32, joint angles of the reference grasp [rad].
        arrival: (B, T) int, in how many frames the teacher would have met the target.
        tasks: B instructions.
        episodes: recordings of those that the student led alone.
    """

    state: np.ndarray
    watching: np.ndarray
    playing: np.ndarray
    released: np.ndarray
    target: np.ndarray
    path: tuple[np.ndarray, ...]
    closed: np.ndarray
    arrival: np.ndarray
    tasks: tuple[str, ...]
    episodes: tuple[Episode, ...]


def play_round(
    batch: WorldBatch,
    student: Student,
    specs: Sequence[EpisodeSpec],
    rng: np.random.Generator,
    teacher_share: float = 0.0,
    *,
    progress: Callable[[float], object] = lambda _: None,
) -> Round:
    """Play one episode in every world of a batch.

    Args:
        batch: the worlds.
        student: moves the hands.
        specs: an episode for each world.
        rng: which episodes the teacher leads instead, and how it is disturbed there.
        teacher_share: share of those.
        progress: called after every frame with the share of the longest episode that is played.
    """
    session, teacher = Session(batch, record_images=False), Intercept()
    jobs = [Job.evaluation(i, spec) for i, spec in enumerate(specs)]
    session.begin(np.arange(batch.size), jobs)
    longest = max(job.frames for job in jobs)
    student.reset(batch.size)
    led = rng.random(batch.size) < teacher_share
    columns: list[dict[str, np.ndarray]] = []
    episodes: list[Episode] = []
    while session.playing.size:
        observation = session.observe(images=True)
        world = batch.world_state(observation)
        columns.append(_labels(session, observation, teacher.arrivals(world)))
        command = _disturbed(teacher.act(world).astype(np.float32), rng)
        commands = np.where(led[:, None], command, student.act(observation))
        for i in session.step(commands).worlds:
            episode = session.finish(int(i), "student")
            episodes += [] if led[i] else [episode]
        progress(len(columns) / longest)
    return Round(
        **{name: np.stack([frame[name] for frame in columns], axis=1) for name in columns[0]},
        path=tuple((spec.oracle_path - spec.home_pos_w).astype(np.float32) for spec in specs),
        closed=np.stack([spec.reference_joints for spec in specs]).astype(np.float32),
        tasks=tuple(spec.task for spec in specs),
        episodes=tuple(episodes),
    )


def _labels(session: Session, observation: Observation, arrival: np.ndarray) -> dict[str, np.ndarray]:
    """What a `Round` keeps of one frame, (B, ...) each."""
    batch = session.batch
    return {
        "state": observation.state,
        "watching": ~is_acting(observation.phase),
        "playing": np.isin(np.arange(batch.size), session.playing),
        "released": batch.released.copy(),
        "target": batch.target_pose[:, :PALM_DOF].astype(np.float32),
        "arrival": arrival,
    }


def _disturbed(command: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Let some of the palms (B, 18) miss their commands."""
    stray = rng.normal(0.0, DISTURBANCE_M, (len(command), PALM_DOF))
    stray[rng.random(len(command)) >= DISTURBED_SHARE] = 0.0
    missed = command.copy()
    missed[:, :PALM_DOF] += stray
    return missed
