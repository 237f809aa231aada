"""A chunk of actions: for which frames it was planned, and from which one on it is executed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Chunk:
    """Actions of one world or of all.

    Attributes:
        actions: (H, ..., 18) commands.
        first: the frame that the first of them is for.
        ready: the frame from which on they are executed.
        expectation: what they were planned for, as their agent keeps it, to correct them.
    """

    actions: np.ndarray
    first: int
    ready: int
    expectation: Any = None

    def action(self, frame: int) -> np.ndarray:
        """Return the (..., 18) action of ``frame``, the last one where the chunk is over."""
        return self.actions[min(frame - self.first, len(self.actions) - 1)]
