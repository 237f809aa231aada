"""Who moves the hand in recordings: the expert, in part perturbed, or a policy. The expert labels
every frame.

A recorded expert executes its own labels. In a share of the episodes its palm is perturbed: pulled
away for several frames at a time, and jittering. A policy trained only on undisturbed approaches
cannot recover from its own first mistake (DART; Laskey et al., 2017). The commands given are
recorded beside the labels.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from dynahoi_lerobot.core.agent import Actor, Agent, Expert, Meeting, Observation, WorldState
from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.conventions import DISTURBANCE_STREAM, PALM_DOF
from dynahoi_lerobot.core.protocols import ControlClass
from dynahoi_lerobot.core.spec import EpisodeSpec

PULL_ODDS = 0.15
"""Probability that a pull begins in a frame without one."""
PULL_M = 0.12
"""Standard deviation along each axis of a pull's destination, from where the palm is when the pull
begins [m]."""
PULL_FRAMES = (2, 8)
"""Shortest and longest pull."""
TREMOR_ODDS, TREMOR_M = 0.5, 0.006
"""Share of the frames without a pull that have tremor, and its standard deviation along each axis
[m]."""
PERTURBED_ATTEMPTS = 3
"""Attempts at an episode that are perturbed, each differently. A further attempt is not, so that
targets that pass only once are recorded too."""


@dataclass
class Perturbation:
    """Pulls and tremor of the palm in one attempt at an episode, determined by seed and attempt.

    Attributes:
        spec: the episode.
        attempt: from 1.
        pull_begin: (F,) int, the frame in which the pull of each frame began, -1 for frames without
            one.
        pull_m: (F, 3) destination of a pull that begins in each frame, from the palm's position
            then [m].
        tremor_m: (F, 3) added to the commands of frames without a pull [m].
        destinations: (3,) of each pull [m], home frame, by the frame in which it began.
    """

    spec: EpisodeSpec
    attempt: int
    pull_begin: np.ndarray
    pull_m: np.ndarray
    tremor_m: np.ndarray
    destinations: dict[int, np.ndarray] = field(default_factory=dict)

    @classmethod
    def drawn(cls, spec: EpisodeSpec, attempt: int, share: float) -> Self:
        """Draw it; only a ``share`` (0 to 1) of the episodes is perturbed, and those in
        ``PERTURBED_ATTEMPTS`` only.
        """
        rng = np.random.default_rng([DISTURBANCE_STREAM, spec.seed, attempt])
        frames = spec.horizon_frames
        perturbed = (
            np.random.default_rng([DISTURBANCE_STREAM, spec.seed]).random() < share
            and attempt <= PERTURBED_ATTEMPTS
        )
        begins = rng.random(frames) < PULL_ODDS
        lengths = rng.integers(PULL_FRAMES[0], PULL_FRAMES[1] + 1, frames)
        pull_m = rng.normal(0.0, PULL_M, (frames, PALM_DOF))
        tremor_m = rng.normal(0.0, TREMOR_M, (frames, PALM_DOF)) * (
            rng.random((frames, 1)) < TREMOR_ODDS
        )
        pull_begin = np.full(frames, -1)
        for frame in np.flatnonzero(begins & perturbed):
            if pull_begin[frame] < 0:
                pull_begin[frame : frame + lengths[frame]] = frame
        return cls(spec, attempt, pull_begin, pull_m, tremor_m * perturbed)

    def __call__(self, frame: int, palm_h: np.ndarray, wanted_h: np.ndarray) -> np.ndarray:
        """Return (3,) the palm's command in a frame [m], home frame.

        Args:
            frame: of the episode.
            palm_h: (3,) where the palm will be when the command takes effect [m].
            wanted_h: (3,) the expert's command [m].
        """
        begin = int(self.pull_begin[frame])
        if begin < 0:
            return wanted_h + self.tremor_m[frame]
        if begin not in self.destinations:
            self.destinations[begin] = palm_h + self.pull_m[begin]
        return self.destinations[begin]


class Labeled(Actor):
    """A hand whose every frame a teacher labels.

    The teacher moves it by its own labels, perturbed in some episodes (DART); or an agent moves it,
    which sees only observations (DAgger; Ross et al., 2011).
    """

    def __init__(
        self,
        teacher: Expert,
        agent: Agent | None = None,
        *,
        name: str = "",
        perturbed_share: float = 0.0,
    ) -> None:
        """Let ``teacher`` label the frames that ``agent`` plays, or else its own.

        Args:
            teacher: if an agent moves the hand, one that ``labels_any_state``.
            agent: moves the hand; None if the teacher does.
            name: labels results; by default the teacher's.
            perturbed_share: of the episodes that the teacher plays, 0 to 1; one that does not label
                any state would not recover and is left alone.
        """
        self.name = name or teacher.name
        self.privileged = agent is None
        self.has_memory = agent is not None
        self.sees_images = agent is not None and agent.sees_images
        self.control_mode = JOINTS if agent is None else agent.control_mode
        self._teacher = teacher
        self._agent = agent
        self._share = perturbed_share if teacher.labels_any_state else 0.0
        self.retries = max(teacher.retries, PERTURBED_ATTEMPTS) if self._share else teacher.retries
        self._perturbations: dict[int, Perturbation] = {}

    def reset(self, count: int) -> None:
        """Let the agent forget the last episodes."""
        if self._agent is not None:
            self._agent.reset(count)

    def leave(self, worlds: np.ndarray) -> None:
        """Let the agent know of episodes that have ended."""
        if self._agent is not None:
            self._agent.leave(worlds)

    def first_meeting(self, spec: EpisodeSpec, control: ControlClass) -> Meeting | None:
        """Return the meeting that the teacher plans if it moves the hand."""
        return self._teacher.first_meeting(spec, control) if self._agent is None else None

    def commands(
        self, observation: Observation, world_state: Callable[[Observation], WorldState]
    ) -> np.ndarray:
        """Return (N, 18) the agent's commands, or the labels with the palms of some worlds
        perturbed.
        """
        world = world_state(observation)
        self.labels = self._teacher.label(world)
        if self._agent is not None:
            return self._agent.act(observation)
        commands = self.labels.copy()
        for i, spec in enumerate(world.specs):
            if spec is not None and self._share and not world.localized[i]:
                self._perturb(commands[i, :PALM_DOF], world, i, spec)
        return commands

    def _perturb(self, palm_h: np.ndarray, world: WorldState, i: int, spec: EpisodeSpec) -> None:
        """Change (3,) the palm's command in world ``i`` [m], home frame, in place."""
        frame = int(world.frame[i])
        attempt = int(world.attempt[i])
        if frame >= spec.horizon_frames:
            return
        known = self._perturbations.get(i)
        if known is None or known.spec is not spec or known.attempt != attempt:
            known = Perturbation.drawn(spec, attempt, self._share)
            self._perturbations[i] = known
        palm_h[:] = known(frame, world.state_when_due[i, :PALM_DOF], palm_h.copy())
