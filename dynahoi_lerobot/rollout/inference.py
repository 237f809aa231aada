"""Inference that takes time: one at a time, while the world moves on and the old chunk of actions
is executed.

`dynahoi evaluate` asks an agent for whole chunks: `RealTimeAgent`. LeRobot's evaluation loop asks a
policy for one action a call: `StepwiseInference`. Both follow one timeline. An inference begins
with the observation of frame t and its chunk, whose first action is for frame t, is ready d frames
later: what is past is skipped. Meanwhile the old chunk continues. The next inference begins when
the last has ended. Until the first chunk is ready, a hand stays where it is; after the last action
of a chunk, where that led.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynahoi_lerobot.core.agent import Agent, Observation
from dynahoi_lerobot.core.conventions import frames_until
from dynahoi_lerobot.core.registry import known

SYNC = "sync"
ASYNC = "async"
RTC = "rtc"
INFERENCE_MODES = {
    SYNC: "the simulation waits for the policy",
    ASYNC: "one inference at a time, while the old chunk continues; past actions of the new "
    "chunk are skipped",
    RTC: "as async, with the new chunk conditioned on actions already committed (real-time "
    "chunking)",
}
MAX_LATENCY_MS = 60_000.0


@dataclass(frozen=True)
class Inference:
    """Timing of a policy's inference.

    Attributes:
        mode: a key of ``INFERENCE_MODES``.
        latency_ms: time from an observation to the chunk that answers it [ms]; None is what each
            inference takes on this machine.

    Raises:
        ValueError: if the mode is unknown, the latency out of range, or ``sync`` is given one.
    """

    mode: str = SYNC
    latency_ms: float | None = 0.0

    def __post_init__(self) -> None:
        known("inference mode", self.mode, INFERENCE_MODES)
        if self.latency_ms is not None and not 0 <= self.latency_ms <= MAX_LATENCY_MS:
            raise ValueError(
                f"the inference latency is {self.latency_ms} ms; it must be from 0 to "
                f"{MAX_LATENCY_MS:g}"
            )
        if self.mode == SYNC and self.latency_ms != 0:
            told = "measured" if self.latency_ms is None else f"{self.latency_ms} ms"
            raise ValueError(
                f"the inference latency is {told}, but with mode sync the world waits; use async "
                f"or rtc"
            )

    @property
    def label(self) -> str:
        """What a table calls it; empty for ``sync``."""
        if self.mode == SYNC:
            return ""
        latency = "measured" if self.latency_ms is None else f"{self.latency_ms:g} ms"
        return f"{self.mode} {latency}"


@dataclass(frozen=True, eq=False)
class Chunk:
    """A chunk of actions of one world or of all.

    Attributes:
        actions: (H, ..., 18) commands.
        first: the frame that the first of them is for.
        ready: the frame from which on they are executed.
    """

    actions: np.ndarray
    first: int
    ready: int

    def action(self, frame: int) -> np.ndarray:
        """Return the (..., 18) action of ``frame``, the last one where the chunk is over."""
        return self.actions[min(frame - self.first, len(self.actions) - 1)]


class RealTimeAgent(Agent):
    """Executes the chunks of an agent whose inference takes time, world by world."""

    def __init__(self, agent: Agent, inference: Inference) -> None:
        """Give ``agent`` the timing ``inference``, of mode ``async`` or ``rtc``.

        Raises:
            ValueError: for ``rtc`` with an agent that cannot be guided.
        """
        if inference.mode == RTC and not agent.accepts_guidance:
            raise ValueError(
                f"inference mode rtc guides a chunk while it is generated, which {agent.name!r} "
                f"does not support; "
                "use async"
            )
        for name in (
            "name",
            "sees_images",
            "views",
            "environment_state",
            "control_mode",
            "privileged",
            "weights",
            "trained_for",
        ):
            setattr(self, name, getattr(agent, name))
        declared_ms = inference.latency_ms
        self._agent = agent
        self._continues = inference.mode == RTC
        self._delay = None if declared_ms is None else frames_until(declared_ms / 1000)
        self._inferences = 0
        self._waited_frames = 0
        self.reset(0)

    def reset(self, count: int) -> None:
        """Forget everything, including inferences under way."""
        self._agent.reset(count)
        self._frame = 0
        self._running: list[Chunk | None] = [None] * count
        self._coming: list[Chunk | None] = [None] * count

    def act(self, observation: Observation) -> np.ndarray:
        """Return (N, 18) the commands that are due."""
        self._receive()
        starting = np.array([i for i, chunk in enumerate(self._coming) if chunk is None], int)
        if starting.size:
            self._infer(observation, starting)
            self._receive()
        else:
            self._agent.observe(observation)
        commands = observation.state.astype(np.float64)
        for i, chunk in enumerate(self._running):
            if chunk is not None:
                commands[i] = chunk.action(self._frame)
        self._frame += 1
        return commands

    def report(self) -> dict[str, Any]:
        """Return the agent's report, and how many frames an inference took on average."""
        frames = self._waited_frames / max(self._inferences, 1)
        return {**self._agent.report(), "inference_frames": round(frames, 3)}

    def _receive(self) -> None:
        """Go on with the chunks that are ready at this frame."""
        for i, chunk in enumerate(self._coming):
            if chunk is not None and chunk.ready <= self._frame:
                self._running[i] = chunk
                self._coming[i] = None

    def _infer(self, observation: Observation, worlds: np.ndarray) -> None:
        """Begin an inference in each of the sorted ``worlds`` (n,)."""
        planned = self._agent.plan(
            observation,
            worlds,
            executed=self._executed(worlds) if self._continues else None,
            delays=self._expected(worlds),
        )
        for i, actions, seconds in zip(worlds, *planned, strict=True):
            if self._delay is not None and self._delay >= len(actions):
                raise ValueError(
                    f"the chunks of {self.name!r} have {len(actions)} actions, all of them past "
                    f"when a chunk is ready "
                    f"after {self._delay} frames; allowed are less than {len(actions)} frames"
                )
            took = frames_until(seconds) if self._delay is None else self._delay
            self._coming[i] = Chunk(actions, self._frame, self._frame + took)
            self._inferences = self._inferences + 1
            self._waited_frames = self._waited_frames + took

    def _executed(self, worlds: np.ndarray) -> np.ndarray | None:
        """The actions that are past of the chunks that continue in ``worlds`` (n,); None at the
        start.
        """
        old = [chunk for i in worlds if (chunk := self._running[i]) is not None]
        return np.array([self._frame - chunk.first for chunk in old]) if old else None

    def _expected(self, worlds: np.ndarray) -> np.ndarray:
        """The frames (n,) that inferences in ``worlds`` will take: as long as the last one, at
        first none.
        """
        if self._delay is not None:
            return np.full(len(worlds), self._delay)
        lasted = [self._running[i] for i in worlds]
        return np.array([0 if chunk is None else chunk.ready - chunk.first for chunk in lasted])


class StepwiseInference:
    """The timeline of a policy that infers in one call and answers the next ones from a queue: it
    decides after which calls the world moves, and what its hands do then.

    The world can stand still while the queue is read, and move on only in the last calls of each
    queue:

        frame seen     0 0 0 0 1 2   3 3 3 3 4 5   6 ...      latency of 3 frames, queue of 6
        actions action read    0 1 2 3 4 5   3 4 5 6 7 8   6 ...      each for the frame of this
        number executed             - - -         3 4 5              in frames 0 1 2, 3 4 5: what is
        past of a chunk is skipped

    Each inference gets the observation of the frame in which it begins, and the frames just before
    it are seen as well. All worlds are asked together, so they begin their inferences together.
    """

    def __init__(
        self, inference: Inference, name: str, n_action_steps: int, *, lookback_frames: int = 0
    ) -> None:
        """Give a policy the timing ``inference``.

        Args:
            inference: of mode ``async``, with a declared latency.
            name: of the policy, for messages.
            n_action_steps: calls that one inference answers.
            lookback_frames: how old the oldest frame is that an inference looks at.

        Raises:
            ValueError: if the mode or the latency is impossible with one action a call, or if the
                policy has no actions left when a chunk is ready, or would see a frame twice.
        """
        if inference.mode != ASYNC:
            raise ValueError(
                f"inference mode {inference.mode} needs whole chunks, and here the policy is "
                f"asked for one action a "
                f"call; use async, or dynahoi evaluate --inference {inference.mode}"
            )
        latency_ms = inference.latency_ms
        if latency_ms is None:
            raise ValueError(
                "a measured latency would count what happens between two calls, such as writing "
                "videos; "
                "declare it in ms, or use dynahoi evaluate --inference-ms measured"
            )
        self._n_action_steps = n_action_steps
        self._delay = frames_until(latency_ms / 1000)
        self._period = max(1, self._delay)
        least = self._delay + 1
        if least > n_action_steps:
            raise ValueError(
                f"{name!r} executes {n_action_steps} actions of a chunk, all of them past when it "
                f"is ready after {latency_ms:g} ms ({self._delay} frames); n_action_steps must be "
                f"at least {least}"
            )
        if lookback_frames > self._delay and n_action_steps > self._period:
            raise ValueError(
                f"{name!r} looks back {lookback_frames} frames and would see some twice, because "
                f"the world stands still while its queue is read; use dynahoi evaluate --inference "
                f"async"
            )
        self.reset()

    def reset(self) -> None:
        """Begin new episodes; the next call is an inference."""
        self._frame = self._begun = 0
        self._read: list[np.ndarray] = []
        self._running: Chunk | None = None

    def calls(self, frames: int) -> int:
        """Return how many calls at most it takes until the world has moved by so many frames."""
        return -(-frames // self._period) * self._n_action_steps

    def answer(self, actions: np.ndarray, state: np.ndarray) -> np.ndarray | None:
        """Take the answer to a call.

        Args:
            actions: (N, 18) commands.
            state: (N, 18) where the hands are; they stay there until the first chunk is ready.

        Returns:
            (N, 18) commands for the frame that passes now; None if the world stands still.
        """
        self._read.append(actions)
        if len(self._read) <= self._n_action_steps - self._period:
            return None
        if not self._delay:
            self._finish()
        commands = state if self._running is None else self._running.action(self._frame)
        self._frame += 1
        if self._delay and len(self._read) == self._n_action_steps:
            self._finish()
        return commands

    def _finish(self) -> None:
        """Go on with the chunk that has been read; its successor is inferred next."""
        self._running = Chunk(np.stack(self._read), self._begun, self._begun + self._delay)
        self._read = []
        self._begun = self._begun + self._period
