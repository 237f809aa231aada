"""What the policy remembers while it acts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import torch
from torch import Tensor

from .frames import EncodedFrames
from .observation import Observation
from .windows import DecisionWindows


class History:
    """A ring buffer of the last frames, read as the window of one decision.

    A frame is encoded when a decision first looks at it, once, however many look at it later.

    Args:
        windows: Which frames a decision sees.
    """

    def __init__(self, windows: DecisionWindows) -> None:
        self.lookback = windows.lookback
        self._frames: deque[Observation | EncodedFrames] = deque(maxlen=1 - self.lookback[0])

    def append(self, frame: Observation) -> None:
        """Remember the newest frame.

        Raises:
            ValueError: If the number of environments changed since the last `clear`.
        """
        if self._frames and len(frame.keep) != len(self._frames[-1].keep):
            raise ValueError(
                f"the batch changed from {len(self._frames[-1].keep)} to {len(frame.keep)} environments: "
                "call policy.reset() between rollouts."
            )
        self._frames.append(frame)

    def window(self, encode: Callable[[Observation], EncodedFrames]) -> EncodedFrames:
        """Return the frames of a decision now; those before the first one are padding, as in a dataset."""
        newest = len(self._frames) - 1
        places = [newest + back for back in self.lookback]
        frames = [self._encoded(max(place, 0), encode) for place in places]
        return EncodedFrames.concatenate(
            [frame if place >= 0 else frame.padding() for place, frame in zip(places, frames, strict=True)]
        )

    def _encoded(self, place: int, encode: Callable[[Observation], EncodedFrames]) -> EncodedFrames:
        frame = self._frames[place]
        if isinstance(frame, Observation):
            frame = self._frames[place] = encode(frame)
        return frame

    def clear(self) -> None:
        """Forget everything."""
        self._frames.clear()


class ChunkQueue:
    """The unexecuted actions of every environment, each with its own place in its own chunk.

    Environments of a batch plan at different moments, because each observes its own phase. A row's behaviour
    must not depend on its neighbours, so nothing here is shared between rows.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget everything; the next step plans for every row."""
        self._chunks: Tensor | None = None
        self._trigger: Tensor | None = None

    def rows_to_plan(self, trigger: Tensor | None, n_rows: int) -> list[int]:
        """Return the rows whose chunk is used up, or whose trigger rose since the last step.

        Args:
            trigger: Value per row whose rise makes the rest of a chunk obsolete, shape ``(B,)``; None never
                does.
            n_rows: Number of rows, ``B``.
        """
        if self._chunks is None:
            self._trigger, self.n_planned = trigger, [0] * n_rows
            return list(range(n_rows))
        due = self._next >= self._chunks.shape[1]
        if trigger is not None:
            due = due | (trigger > self._trigger + 1e-3).cpu()
        self._trigger = trigger
        return due.nonzero().flatten().tolist()

    def put(self, rows: list[int], chunks: Tensor) -> None:
        """Replace what is left of ``rows`` by new chunks, shape ``(len(rows), n, A)``."""
        if self._chunks is None:
            self._chunks = torch.zeros_like(chunks)
            self._next = torch.zeros(len(chunks), dtype=torch.long)
        self._chunks[rows] = chunks
        self._next[rows] = 0
        for row in rows:
            self.n_planned[row] += 1

    def pop(self) -> Tensor:
        """Return the next action of every row, shape ``(B, A)``."""
        actions = self._chunks[torch.arange(len(self._chunks)), self._next]
        self._next = self._next + 1
        return actions
