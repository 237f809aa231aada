"""One inference at a time for a policy that is asked for one action a call, as LeRobot's evaluation loop does.

``select_action`` infers in one call and answers the next ones from a queue. So the world can stand still while the
queue is read, and move on only in the last calls of each queue:

    frame seen     0 0 0 0 1 2   3 3 3 3 4 5   6 ...      latency of 3 frames, queue of 6 actions
    action read    0 1 2 3 4 5   3 4 5 6 7 8   6 ...      each for the frame of this number
    executed             - - -         3 4 5              in frames 0 1 2, 3 4 5: what is past of a chunk is skipped

Each inference gets the observation of the frame in which it begins, and the frames just before it are seen as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.rollout.chunk import Chunk
from dynahoi_lerobot.rollout.inference import ASYNC, Inference, frames_of


@dataclass(frozen=True)
class QueuedPolicy:
    """How a policy answers calls for one action.

    Attributes:
        name: for messages.
        n_action_steps: calls that one inference answers.
        skipped_frames: frames between its observation and the one that its first action is for.
        lookback_frames: how old the oldest frame is that an inference looks at.
    """

    name: str
    n_action_steps: int
    skipped_frames: int = 0
    lookback_frames: int = 0


class StepwiseInference:
    """Decides after which calls the world moves, and what the hands of N worlds do then.

    All worlds are asked together, so they begin their inferences together.
    """

    def __init__(self, policy: QueuedPolicy, inference: Inference) -> None:
        """Give ``policy`` the timing ``inference``.

        Raises:
            ValueError: if the mode or the latency cannot be had one action a call, or not with this policy.
        """
        latency_ms = _declared_ms(inference)
        self.policy, self._delay = policy, frames_of(latency_ms / 1000)
        self._period = max(1, self._delay)
        _check_policy(policy, self._delay, f"after {latency_ms:g} ms ({self._delay} frames)")
        self.reset()

    def reset(self) -> None:
        """Begin new episodes; the next call is an inference."""
        self._frame = self._begun = 0
        self._read: list[np.ndarray] = []
        self._running: Chunk | None = None

    def calls(self, frames: int) -> int:
        """Return how many calls at most it takes until the world has moved by so many frames."""
        return -(-frames // self._period) * self.policy.n_action_steps

    def answer(self, actions: np.ndarray, state: np.ndarray) -> np.ndarray | None:
        """Take the answer to a call.

        Args:
            actions: (N, 18) commands.
            state: (N, 18) where the hands are; they stay there until the first chunk is ready.

        Returns:
            (N, 18) commands for the frame that passes now; None if the world stands still.
        """
        self._read.append(actions)
        if len(self._read) <= self.policy.n_action_steps - self._period:
            return None
        if not self._delay:
            self._finish()
        commands = state if self._running is None else self._running.action(self._frame)
        self._frame += 1
        if self._delay and len(self._read) == self.policy.n_action_steps:
            self._finish()
        return commands

    def _finish(self) -> None:
        """Go on with the chunk that has been read; its successor is inferred next."""
        first = self._begun + self.policy.skipped_frames
        self._running = Chunk(np.stack(self._read), first, self._begun + self._delay)
        self._read, self._begun = [], self._begun + self._period


def _declared_ms(inference: Inference) -> float:
    """Return the latency; raise ValueError for a timing that cannot be had one action a call."""
    if inference.mode != ASYNC:
        raise ValueError(
            f"inference mode {inference.mode} needs whole chunks, and here the policy is asked for one action a call; "
            f"use async, or dynahoi evaluate --inference {inference.mode}"
        )
    if inference.latency_ms is None:
        raise ValueError(
            "a measured latency would count what happens between two calls, such as writing videos; "
            "declare it in ms, or use dynahoi evaluate --inference-ms measured"
        )
    return inference.latency_ms


def _check_policy(policy: QueuedPolicy, delay: int, after: str) -> None:
    """Raise ValueError unless the policy has actions left when a chunk is ready, and sees every frame once."""
    n, period = policy.n_action_steps, max(1, delay)
    if policy.skipped_frames > delay:
        raise ValueError(
            f"{policy.name!r} skips {policy.skipped_frames} frames of a chunk that is ready {after}; allowed are up "
            f"to {delay}"
        )
    if (least := max(period, delay - policy.skipped_frames + 1)) > n:
        raise ValueError(
            f"{policy.name!r} executes {n} actions of a chunk, all of them past when it is ready {after}; "
            f"n_action_steps must be at least {least}"
        )
    if policy.lookback_frames > delay and n > period:
        raise ValueError(
            f"{policy.name!r} looks back {policy.lookback_frames} frames and would see some twice, because the world "
            "stands still while its queue is read; use dynahoi evaluate --inference async"
        )
