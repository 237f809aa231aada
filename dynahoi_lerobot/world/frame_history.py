"""What was measured in the last frames of the worlds."""

import numpy as np


class FrameHistory:
    """What was last measured in N worlds; before an episode's start stands what was measured first.

    Attributes:
        values: (depth, N, ...), newest first.
        frame: (N,) int, of each world's newest, -1 where there is none yet.
    """

    def __init__(self, size: int, depth: int, shape: tuple[int, ...], dtype: type = float) -> None:
        self.values = np.zeros((depth, size, *shape), dtype)
        self.frame = np.full(size, -1)

    def forget(self, ids: np.ndarray) -> None:
        """Forget worlds ``ids`` (n,), whose episodes begin."""
        self.frame[ids] = -1

    def add(self, i: int, value: np.ndarray, frame: int) -> None:
        """Add a measurement of world ``i`` at a frame; frames since the last that were left out
        show the same.
        """
        passed = frame - int(self.frame[i])
        if self.frame[i] < 0:
            self.values[:, i] = value
        elif passed:
            self.values[passed:, i] = self.values[:-passed, i].copy()
        self.values[: max(passed, 1), i] = value
        self.frame[i] = frame
