"""The phase of a frame as policies see it: one-hot, observing or acting.

Two numbers where one would do: LeRobot stores a feature of one number as a scalar, and its streaming reader makes no
windows over scalars, which a policy with history asks for.
"""

from __future__ import annotations

import numpy as np

PHASES = ("observing", "acting")
ACTING = PHASES.index("acting")


def one_hot_phase(acting: np.ndarray) -> np.ndarray:
    """Return the phase of frames, (..., 2) float32: [1, 0] while observing, [0, 1] while ``acting`` (...) bool."""
    return np.stack([~acting, acting], axis=-1).astype(np.float32)


def is_acting(phase: np.ndarray) -> np.ndarray:
    """Return (...) bool of a phase (..., 2), whether a command given at the frame takes effect."""
    return phase[..., ACTING] > 0.5
