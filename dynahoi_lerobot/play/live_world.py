"""One world that moves at 20 Hz by the wall clock, whether or not a command comes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.conventions import CONTROL_HZ, HAND_DOF
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import Session
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import kind_seed
from dynahoi_lerobot.world.batch import WorldBatch

if TYPE_CHECKING:
    from dynahoi_lerobot.core.agent import Observation
    from dynahoi_lerobot.core.episode import Episode
    from dynahoi_lerobot.core.spec import EpisodeSpec
    from dynahoi_lerobot.sampling.recipe import Recipe


class LiveWorld:
    """One hand and one moving object on a clock.

    The world is brought up to date whenever somebody looks at it or commands it, so that it needs
    no thread, and what happens in it depends on the times of observations and commands alone. The
    first command starts the clock, so that frame 0 ends midway between that command and the next
    observation, which is due one frame (50 ms) after the last. A player that observes and commands
    once per frame then always commands the frame it saw, with 25 ms of slack either way if it acts
    at once; deciding takes half its time from that slack. In a frame without a new command the hand
    follows the last one.

    Attributes:
        recipe, kind: the episodes to play.
        spec: the episode.
        missed: frames of the control phase of this episode in which no new command came.
        finished: the recording of this episode, once it is over; else None.
    """

    spec: EpisodeSpec

    def __init__(
        self,
        recipe: Recipe,
        kind: str | None = None,
        *,
        realtime: bool = True,
        record_images: bool = False,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Allocate the world; no episode begins yet.

        Args:
            recipe: the episodes.
            kind: the kind of motion that is played; None for all of the recipe.
            realtime: whether the clock moves the world; else each command moves it by one frame.
            record_images: whether the recording of an episode holds its images.
            clock: returns the time [s].
        """
        self.recipe = recipe
        self.kind = kind
        self.missed = 0
        self.finished: Episode | None = None
        self._realtime = realtime
        self._clock = clock
        self._session = Session(WorldBatch(recipe.rules, 1), record_images=record_images)
        self._expert = EXPERTS[recipe.rules.capture_rule.expert]()
        self._started_s: float | None = None
        self._command = np.zeros(HAND_DOF)
        self._fresh = False

    def begin(self, number: int, player: str) -> None:
        """Lay out episode ``number`` of the split and the kind: its frame 0 can be seen, its clock
        stands still.

        Raises:
            ValueError: for a negative number or one beyond 2^40 - 1.
        """
        [self.spec] = sample_specs(self.recipe, [kind_seed(self.recipe, self.kind, number)])
        self._session.begin([0], [Job.evaluation(number, self.spec)])
        self._session.observe(images=self._session.record_images)
        self._command = self._session.batch.executed[0].copy()
        self._fresh = False
        self._started_s, self._observed_s = None, self._clock()
        self.missed = 0
        self.finished = None
        self._player = player

    @property
    def batch(self) -> WorldBatch:
        """The batch of this one world."""
        return self._session.batch

    @property
    def facts(self) -> dict[str, Any]:
        """What a player is told of the present: the task, seconds left of window and episode,
        whether it is caught.
        """
        spec = self.spec
        frame = int(self.batch.frame[0])
        return {
            "task": spec.task,
            "window_s": max(0, spec.window_frames - frame) / CONTROL_HZ,
            "left_s": (spec.window_frames + spec.length_frames + 1 - frame) / CONTROL_HZ,
            "caught": bool(self.batch.localized[0]),
        }

    @property
    def rest_s(self) -> float:
        """Seconds until the clock moves the world next, 0 before the first command."""
        if self._started_s is None:
            return 0.0
        return max(0.0, self._started_s + (self.batch.frame[0] + 0.5) / CONTROL_HZ - self._clock())

    def observe(self, *, images: bool = True) -> Observation:
        """Return the observation of the one world: images (1, H, W, 3), state (1, 18) and so on."""
        self.catch_up()
        if self._started_s is None:
            self._observed_s = self._clock()
        if images and not self._seen.images:
            return self._session.observe(ending=np.zeros(1, int))
        return self._seen

    def command(self, command: np.ndarray) -> None:
        """Give the hand its next command, (18,): palm center [m], home frame, and joint angles
        [rad].

        The first one starts the clock.

        Raises:
            ValueError: for a wrong shape or a value that is not finite.
        """
        commands = np.asarray(command, np.float64)[None]
        given = self.batch.commands.read(commands, self._seen.state, JOINTS)[0]
        if self._started_s is None:
            now_s = self._clock()
            self._started_s = now_s - min(now_s - self._observed_s, 1 / CONTROL_HZ) / 2
        else:
            self.catch_up()
        self._command = given
        self._fresh = True
        if not self._realtime and self.finished is None:
            self._tick()

    def expert_goal(self) -> np.ndarray:
        """Return (18,) the command that the capture rule's privileged expert would give now."""
        self.catch_up()
        return self._expert.act(self._session.world_state(self._seen))[0]

    @property
    def _seen(self) -> Observation:
        assert self._session.observation is not None, "begin comes first"
        return self._session.observation

    def catch_up(self) -> None:
        """Move the world to the present, as whoever looks at it or commands it does."""
        if not self._realtime or self._started_s is None:
            return
        due = int((self._clock() - self._started_s) * CONTROL_HZ + 0.5)
        while self.finished is None and self._session.batch.frame[0] < due:
            self._tick()

    def _tick(self) -> None:
        batch = self._session.batch
        self.missed += bool(batch.accepting[0]) and not self._fresh
        self._fresh = False
        terminated, truncated = self._session.step(self._command[None], control_mode=JOINTS)
        self._session.observe(images=self._session.record_images)
        if terminated[0] or truncated[0]:
            self.finished = self._session.finish(0, self._player)
