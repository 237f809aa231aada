"""Commands on their way: where they will have brought the palm, and what is executed meanwhile."""

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import Tensor

from .configuration_obact import Embodiment
from .frames import palm_of, stepped

STUCK_SHARE = 0.25
"""A palm that covered at most this share of its commanded way is stuck: one that obeys covers all
of it, or half where frames come twice as often as ticks, and one that is stuck none."""
LEAST_TOLD_M = 1e-3
"""A shorter commanded way decides nothing: a palm that hovers at its goal stands still, too."""


class CommandBuffer:
    """The actions of B environments by the tick that they are for, as long as they matter."""

    def __init__(self, embodiment: Embodiment) -> None:
        self._embodiment = embodiment
        self._actions: dict[int, Tensor] = {}  # (B, A) each, in the order of ticks

    def expected_palm(self, palms: Tensor, ticks: Sequence[int], inference_delay: int) -> Tensor:
        """Return where palms will be when the next command takes effect [m], ``(B, 3)``.

        Until then a palm goes where the commands send it that were given, but have no effect yet,
        in each tick as far as its speed allows. A palm that is stuck, as in an observation window,
        stays: it did not go where the commands sent it that took effect since the tick before.

        Args:
            palms: where they were in the last frames [m], ``(B, T, 3)``.
            ticks: when those were seen, ``(T,)``; a loop that is faster than the ticks sees several
                frames in one.
            inference_delay: ticks until the next command is given.
        """
        palm = palms[:, -1]
        now = ticks[-1]
        before = max((tick for tick in ticks if tick < now), default=None)
        delay = self._embodiment.delay_frames
        if before is None or not any(tick < now - delay for tick in self._actions):
            return palm
        palm_before = palms[:, ticks.index(before)]
        expected = self._followed(palm, range(now - delay, now + inference_delay))
        told = self._followed(palm_before, range(before - delay, now - delay)) - palm_before
        told_m = told.norm(dim=-1)
        moved_m = (palm - palm_before).norm(dim=-1)
        stuck = (told_m > LEAST_TOLD_M) & (moved_m <= STUCK_SHARE * told_m)
        return torch.where(stuck[:, None], palm, expected)

    def _followed(self, palm: Tensor, ticks: Iterable[int]) -> Tensor:
        """Return where palms ``(B, 3)`` get [m] that follow the commands for some ticks, each until
        the next one.
        """
        for tick in ticks:
            given = max((given for given in self._actions if given <= tick), default=None)
            if given is not None:
                palm = stepped(palm, palm_of(self._actions[given]), self._embodiment.step_m)
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
        # `expected_palm` looks back to the command that was in effect a tick before
        oldest = max((old for old in self._actions if old < effective), default=effective)
        goes_on = {old: x for old, x in self._actions.items() if oldest <= old < tick + ready}
        if goes_on:
            last = goes_on[max(goes_on)]
            given[:ready] = [goes_on.get(tick + i, last) for i in range(ready)]
        self._actions = goes_on | {tick + i: action for i, action in enumerate(given)}
        return torch.stack(given, dim=1)

    def keep_rows(self, rows: Any) -> None:
        """Go on with the environments of rows ``(R,)`` alone."""
        self._actions = {frame: action[rows] for frame, action in self._actions.items()}
