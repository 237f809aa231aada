"""What happens to commands on their way to the servos: they are late, and the palm may miss them.

Disturbance injection shows how to recover. A policy that only ever saw an undisturbed expert does not know what to do
after its own first mistake. Disturbing the execution and recording the expert's commands, not what became of them,
shows it (DART; Laskey et al., 2017).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.core.conventions import HAND_DOF, PALM_DOF
from dynahoi_lerobot.core.spec import EpisodeSpec

DISTURBED_SHARE = 0.3
"""Share of the frames of the control phase in which the palm is disturbed."""
STREAM = 0xD157


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


class DisturbanceInjection:
    """What is added to the commands of N worlds before they are executed, and not recorded."""

    def __init__(self, size: int, spread_m: float) -> None:
        """Serve ``size`` worlds; ``spread_m`` is the standard deviation along each axis [m], 0 for none."""
        self._spread_m = spread_m
        self._offsets = [np.zeros((0, PALM_DOF))] * size

    def reset(self, i: int, spec: EpisodeSpec, attempt: int) -> None:
        """Draw the disturbance of the ``attempt``-th try (from 1) at an episode in world ``i``."""
        if self._spread_m:
            self._offsets[i] = draw_disturbance(spec, attempt, self._spread_m)

    def offsets(self, ids: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Return (n, 18) by how much the commands of worlds ``ids`` (n,) are missed at their ``frames`` (n,)."""
        missed = np.zeros((len(ids), HAND_DOF))
        if self._spread_m:
            missed[:, :PALM_DOF] = [self._offsets[i][frame] for i, frame in zip(ids, frames, strict=True)]
        return missed


def draw_disturbance(spec: EpisodeSpec, attempt: int, spread_m: float) -> np.ndarray:
    """Return (F, 3) by how much each frame's palm command is missed [m], world.

    It is zero in the observation window and from the intercept on, or nothing would be caught.

    Args:
        spec: the episode; with ``attempt`` it decides every draw.
        attempt: from 1.
        spread_m: standard deviation along each axis [m].
    """
    rng = np.random.default_rng([STREAM, spec.seed, attempt])
    offsets = rng.normal(0.0, spread_m, (len(spec.oracle_path), PALM_DOF))
    offsets[rng.random(len(offsets)) >= DISTURBED_SHARE] = 0.0
    offsets[: spec.window_frames] = 0.0
    offsets[spec.intercept_frame - 1 :] = 0.0  # the last command before the intercept is the one that must be met
    return offsets
