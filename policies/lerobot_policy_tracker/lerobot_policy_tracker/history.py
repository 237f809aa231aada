"""Memory while acting: a ring buffer of frames, and the queue of predicted actions."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

import torch
from torch import Tensor

from .frames import EncodedFrames
from .observation import Observation
from .windows import DecisionWindows


class History:
    """A ring buffer of the last frames, which returns the window of a decision.

    Frames are encoded lazily, when a decision first attends to them, and only once.

    Args:
        windows: frame offsets of a decision.
    """

    def __init__(self, windows: DecisionWindows) -> None:
        self.lookback = windows.lookback
        self._frames: deque[Observation | EncodedFrames] = deque(maxlen=1 - self.lookback[0])

    def append(self, frame: Observation | EncodedFrames) -> None:
        """Add the newest frame.

        Raises:
            ValueError: if the number of environments changed since the last `clear`.
        """
        if self._frames and len(frame.keep) != len(self._frames[-1].keep):
            raise ValueError(
                f"the batch changed from {len(self._frames[-1].keep)} to {len(frame.keep)} environments: "
                "call policy.reset() between rollouts."
            )
        self._frames.append(frame)

    def window(self, encode: Callable[[Observation], EncodedFrames]) -> EncodedFrames:
        """Return the window of a decision at the newest frame; frames before the first are padding, as in a dataset.

        Args:
            encode: encodes a frame.

        Returns:
            Frames of shape ``(B, s + 1)``, oldest first.
        """
        return self._at(self.lookback, encode)

    def latest(self, n: int, encode: Callable[[Observation], EncodedFrames]) -> EncodedFrames:
        """Return the ``n`` newest frames, ``(B, n)``, oldest first; see `window`."""
        return self._at(range(1 - n, 1), encode)

    def _at(self, offsets: Iterable[int], encode: Callable[[Observation], EncodedFrames]) -> EncodedFrames:
        newest = len(self._frames) - 1
        positions = [newest + back for back in offsets]
        frames = [self._encoded(max(position, 0), encode) for position in positions]
        return EncodedFrames.concatenate(
            [frame if position >= 0 else frame.padding() for position, frame in zip(positions, frames, strict=True)]
        )

    def _encoded(self, position: int, encode: Callable[[Observation], EncodedFrames]) -> EncodedFrames:
        frame = self._frames[position]
        if isinstance(frame, Observation):
            frame = self._frames[position] = encode(frame)
        return frame

    def clear(self) -> None:
        """Drop all frames."""
        self._frames.clear()


class ChunkQueue:
    """The unexecuted actions of every environment, each with its own position in its own chunk.

    Environments of a batch replan at different times, because each has its own phase. The actions of one row must not
    depend on the other rows, so no state is shared between rows.

    Attributes:
        n_planned: number of chunks predicted in each row since the last `clear`.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Drop all chunks; the next step plans for every row."""
        self._chunks: Tensor | None = None
        self._next = torch.zeros(0, dtype=torch.long)
        self._trigger: Tensor | None = None
        self.n_planned: list[int] = []

    def rows_to_plan(self, trigger: Tensor | None, n_rows: int) -> list[int]:
        """Return the rows whose chunk is used up, or whose trigger rose since the last step.

        Args:
            trigger: value per row whose rise makes the rest of a chunk obsolete, shape ``(B,)``; None disables this.
            n_rows: number of rows, ``B``.
        """
        if self._chunks is None:
            self._trigger, self.n_planned = trigger, [0] * n_rows
            return list(range(n_rows))
        due = self._next >= self._chunks.shape[1]
        if trigger is not None and self._trigger is not None:
            due = due | (trigger > self._trigger + 1e-3).cpu()
        self._trigger = trigger
        return due.nonzero().flatten().tolist()

    def put(self, rows: list[int], chunks: Tensor) -> None:
        """Replace the chunks of ``rows`` by new ones, shape ``(len(rows), n, A)``."""
        if self._chunks is None:
            self._chunks = torch.zeros_like(chunks)
            self._next = torch.zeros(len(chunks), dtype=torch.long)
        self._chunks[rows] = chunks
        self._next[rows] = 0
        for row in rows:
            self.n_planned[row] += 1

    def pop(self) -> Tensor:
        """Return the next action of every row, shape ``(B, A)``.

        Raises:
            RuntimeError: if no chunk was put since the last `clear`.
        """
        if self._chunks is None:
            raise RuntimeError("the queue is empty: put a chunk before the first pop.")
        actions = self._chunks[torch.arange(len(self._chunks)), self._next]
        self._next = self._next + 1
        return actions
