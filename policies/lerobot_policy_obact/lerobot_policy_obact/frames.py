"""Frames: what is observed in them, the history of an episode, and where palms get in one."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import torch
from torch import Tensor, nn

from .layers import smooth_norm


@dataclass(frozen=True)
class Record:
    """A named collection of tensors, or of records of tensors."""

    def map(self, change: Callable[[Any], Any]) -> Self:
        """Return a copy with ``change`` applied to every tensor in it."""
        held = {field.name: getattr(self, field.name) for field in fields(self)}
        tensors = {name: x for name, x in held.items() if isinstance(x, (Tensor, Record))}
        return replace(self, **{name: change(x) for name, x in tensors.items()})

    def to(self, device: str | torch.device) -> Self:
        """Return a copy on a device."""
        return self.map(lambda x: x.to(device))

    def __getitem__(self, index: Any) -> Self:
        """Return a copy with every tensor indexed; all must begin with the same axes."""
        return self.map(lambda x: x[index])


@dataclass(frozen=True)
class Frames(Record):
    """T frames of B episodes, in the order of time."""

    # by camera (u, v, log depth) and two log scales, then the embedding, (B, T, C, 5 + E)
    sightings: Tensor
    state: Tensor  # of the robot, (B, T, S)
    time_s: Tensor  # when they were seen [s], (T,)
    hidden: Tensor  # whether they come before the episode's first, (B, T)

    @property
    def palm(self) -> Tensor:
        """Where the palm is [m], ``(B, T, 3)``."""
        return palm_of(self.state)

    def __getitem__(self, index: Any) -> Self:
        """Return the frames of some episodes; all have the same times."""
        chosen = {name: getattr(self, name)[index] for name in ("sightings", "state", "hidden")}
        return replace(self, **chosen)


class ObservationHistory:
    """The last ``length`` frames of the episodes that are played, at ``fps`` ticks a second.

    Attributes:
        ticks: of the frames, counted from the first one of the episode, oldest first; empty before
            the first frame.
        now_s: when the newest was seen [s].
        began_s: when the first was seen [s].
    """

    def __init__(self, length: int, fps: float) -> None:
        self._frames: deque[Frames] = deque(maxlen=length)
        self._fps = fps
        self.ticks: deque[int] = deque(maxlen=length)
        self.now_s = 0.0
        self.began_s = 0.0

    def add(self, sightings: Tensor, state: Tensor, time_s: float) -> None:
        """Add what B environments show at ``time_s``: ``(B, C, 5 + E)`` and ``(B, S)``.

        Raises:
            ValueError: if that is earlier than the frame before.
        """
        if not self.ticks:
            self.began_s = time_s
        elif time_s < self.now_s:
            raise ValueError(
                f"the timestamp is {time_s:.3f} s after {self.now_s:.3f} s, but must not go back: "
                "call policy.reset() when an episode begins."
            )
        self.now_s = time_s
        self.ticks.append(self._tick(time_s))
        # counted from the first frame, because single precision holds no times of day, and rounded,
        # so that timestamps in single precision and counting say the same
        elapsed_s = state.new_tensor([round(time_s - self.began_s, 4)])
        hidden = torch.zeros(len(state), 1, dtype=torch.bool, device=state.device)
        self._frames.append(Frames(sightings[:, None], state[:, None], elapsed_s, hidden))

    def keep_rows(self, rows: Any) -> None:
        """Go on with the environments of rows ``(R,)`` alone."""
        kept = [frame[rows] for frame in self._frames]
        self._frames = deque(kept, maxlen=self._frames.maxlen)

    def next_tick_s(self, now_s: float) -> float:
        """Return the time of the tick that is nearest to ``now_s``, after the newest frame [s]."""
        tick_s = self.began_s + self._tick(now_s) / self._fps
        return max(tick_s, self.now_s + 1 / self._fps)

    def _tick(self, time_s: float) -> int:
        return round((time_s - self.began_s) * self._fps)

    def frames(self) -> Frames:
        """Return the T frames, oldest first."""
        return Frames(
            torch.cat([frame.sightings for frame in self._frames], dim=1),
            torch.cat([frame.state for frame in self._frames], dim=1),
            torch.cat([frame.time_s for frame in self._frames]),
            torch.cat([frame.hidden for frame in self._frames], dim=1),
        )


def gather_frames(table: Tensor, frame: Tensor) -> Tensor:
    """Return what tables ``(B, T, ...)`` hold for frames ``(B, Q...)``, ``(B, Q..., ...)``."""
    rows = torch.arange(len(frame), device=frame.device)
    return table[rows.view(-1, *[1] * (frame.dim() - 1)), frame]


def palm_of(state: Tensor) -> Tensor:
    """Return where palms are [m], ``(..., 3)``: the first entries of a state or action, as many as
    there are.
    """
    return nn.functional.pad(state[..., :3], (0, max(0, 3 - state.shape[-1])))


def stepped(palm: Tensor, goal: Tensor, step_m: float) -> Tensor:
    """Return where palms ``(..., 3)`` [m] are a frame later that go towards their goals, at most
    ``step_m`` far.
    """
    left = goal - palm
    reach = step_m / smooth_norm(left)
    return palm + left * reach[..., None].clamp_max(1.0)
