"""What happens to commands on their way to the servos: they are late."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.core.conventions import HAND_DOF


class CommandLatency:
    """The commands of N worlds that have been given and have not taken effect."""

    def __init__(self, size: int, frames: int) -> None:
        """Delay the commands of ``size`` worlds by ``frames`` control steps, 0 for none."""
        self.frames = frames
        self._pending = np.zeros((frames, size, HAND_DOF))  # oldest first

    def reset(self, i: int, rest: np.ndarray) -> None:
        """Let world ``i`` begin with nothing on its way: until the first command is due it stays at ``rest`` (18,)."""
        self._pending[:, i] = rest

    def exchange(self, ids: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Take the commands (n, 18) given to worlds ``ids`` (n,) and return (n, 18) those that are due."""
        if not self.frames:
            return commands
        due = self._pending[0, ids].copy()
        self._pending[:-1, ids] = self._pending[1:, ids]
        self._pending[-1, ids] = commands
        return due

    def pending(self) -> Iterator[np.ndarray]:
        """Yield (N, 18) the commands on their way, in the order in which they are due."""
        yield from self._pending
