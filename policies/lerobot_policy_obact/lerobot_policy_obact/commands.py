"""Commands on their way: where they will have brought the palm, and what is executed meanwhile."""

from typing import Any

import torch
from torch import Tensor

from .configuration_obact import Embodiment
from .frames import palm_of, stepped

HELD_SHARE = 0.5
"""A palm that covered at most this share of its commanded way is held: one that obeys covers all of
it, one that is held none."""
LEAST_TOLD_M = 1e-3
"""A shorter commanded way decides nothing: a palm that hovers at its goal stands still, too."""


class CommandBuffer:
    """The actions of B environments by the frame that they are for, as long as they matter."""

    def __init__(self, embodiment: Embodiment) -> None:
        self._embodiment = embodiment
        self._actions: dict[int, Tensor] = {}  # (B, A) each, in the order of frames

    def due(self, palms: Tensor, frame: int, inference_delay: int) -> Tensor:
        """Return where palms will be when the next command takes effect [m], ``(B, 3)``.

        Until then a palm goes where the commands send it that were given, but have no effect yet,
        in each frame as far as its speed allows. A palm that is held, as in an observation window,
        stays: it did not go where the command that took effect last sent it.

        Args:
            palms: where they were in the last frames [m], ``(B, T, 3)``.
            frame: number of the newest of these.
            inference_delay: frames until the next command is given.
        """
        palm = palms[:, -1]
        step_m = self._embodiment.step_m
        effective = frame - self._embodiment.delay_frames
        executed = self._actions.get(effective - 1)
        if executed is None or palms.shape[1] < 2:
            return palm
        due = palm
        for coming in range(effective, frame + inference_delay):
            # after the last command a palm goes on to where that sends it
            action = self._actions.get(min(coming, max(self._actions)))
            due = due if action is None else stepped(due, palm_of(action), step_m)
        before = palms[:, -2]
        told_m = (stepped(before, palm_of(executed), step_m) - before).norm(dim=-1)
        moved_m = (palm - before).norm(dim=-1)
        held = (told_m > LEAST_TOLD_M) & (moved_m <= HELD_SHARE * told_m)
        return torch.where(held[:, None], palm, due)

    def give(self, chunk: Tensor, frame: int, inference_delay: int) -> Tensor:
        """Note the actions of a chunk, and return what is executed from ``frame`` on, ``(B, H,
        A)``.

        Until the chunk is ready, the last one goes on, and after its end, where that led. Where
        there is none, nobody can execute anything, and the chunk stays as it is.

        Args:
            chunk: actions for ``frame`` and the next ones, ``(B, H, A)``.
            frame: number of the frame that it follows from.
            inference_delay: frames until it is ready.
        """
        given = list(chunk.unbind(1))
        ready = min(inference_delay, len(given) - 1)
        effective = frame - self._embodiment.delay_frames
        for old in [old for old in self._actions if not effective - 1 <= old < frame + ready]:
            del self._actions[old]
        if self._actions:
            last = self._actions[max(self._actions)]
            given[:ready] = [self._actions.get(frame + i, last) for i in range(ready)]
        self._actions |= {frame + i: given[i] for i in range(ready, len(given))}
        return torch.stack(given, dim=1)

    def keep_rows(self, rows: Any) -> None:
        """Go on with the environments of rows ``(R,)`` alone."""
        self._actions = {frame: action[rows] for frame, action in self._actions.items()}
