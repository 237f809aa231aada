"""Commands on their way: where they will have brought the palm, and what is executed meanwhile."""

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import Tensor

from .configuration_obact import Embodiment
from .frames import palm_of, stepped

STUCK_SHARE = 0.5
"""A palm that covered at most this share of its commanded way is stuck: one that obeys covers all
of it, one that is stuck none."""
LEAST_TOLD_M = 1e-3
"""A shorter commanded way decides nothing: a palm that hovers at its goal stands still, too."""


class CommandBuffer:
    """The actions of B environments by the tick that they are for, as long as they matter."""

    def __init__(self, embodiment: Embodiment) -> None:
        self._embodiment = embodiment
        self._actions: dict[int, Tensor] = {}  # (B, A) each, in the order of ticks

    def due(self, palms: Tensor, ticks: Sequence[int], inference_delay: int) -> Tensor:
        """Return where palms will be when the next command takes effect [m], ``(B, 3)``.

        Until then a palm goes where the commands send it that were given, but have no effect yet,
        in each tick as far as its speed allows. A palm that is stuck, as in an observation window,
        stays: it did not go where the commands sent it that took effect since the frame before.

        Args:
            palms: where they were in the last frames [m], ``(B, T, 3)``.
            ticks: when those were seen, ``(T,)``.
            inference_delay: ticks until the next command is given.
        """
        palm = palms[:, -1]
        if len(ticks) < 2:
            return palm
        before = palms[:, -2]
        delay = self._embodiment.delay_frames
        executed = range(ticks[-2] - delay, ticks[-1] - delay)
        if not self._actions.keys() & {*executed}:
            return palm
        due = self._followed(palm, range(ticks[-1] - delay, ticks[-1] + inference_delay))
        told_m = (self._followed(before, executed) - before).norm(dim=-1)
        moved_m = (palm - before).norm(dim=-1)
        stuck = (told_m > LEAST_TOLD_M) & (moved_m <= STUCK_SHARE * told_m)
        return torch.where(stuck[:, None], palm, due)

    def _followed(self, palm: Tensor, ticks: Iterable[int]) -> Tensor:
        """Return where palms ``(B, 3)`` get [m] that follow the commands for some ticks."""
        last = max(self._actions)  # after which a palm goes on to where that command sends it
        for tick in ticks:
            action = self._actions.get(min(tick, last))
            if action is not None:
                palm = stepped(palm, palm_of(action), self._embodiment.step_m)
        return palm

    def give(self, chunk: Tensor, tick: int, inference_delay: int) -> Tensor:
        """Note the actions of a chunk, and return what is executed from ``tick`` on, ``(B, H, A)``.

        Until the chunk is ready, the last one goes on, and after its end, where that led. The first
        chunk has none before it, and is returned as it is.

        Args:
            chunk: actions for ``tick`` and the next ones, ``(B, H, A)``.
            tick: of the frame that it follows from.
            inference_delay: ticks until it is ready.
        """
        given = list(chunk.unbind(1))
        ready = min(inference_delay, len(given) - 1)
        effective = tick - self._embodiment.delay_frames
        for old in [old for old in self._actions if not effective - 1 <= old < tick + ready]:
            del self._actions[old]
        if self._actions:
            last = self._actions[max(self._actions)]
            given[:ready] = [self._actions.get(tick + i, last) for i in range(ready)]
        self._actions |= {tick + i: given[i] for i in range(ready, len(given))}
        return torch.stack(given, dim=1)

    def keep_rows(self, rows: Any) -> None:
        """Go on with the environments of rows ``(R,)`` alone."""
        self._actions = {frame: action[rows] for frame, action in self._actions.items()}
