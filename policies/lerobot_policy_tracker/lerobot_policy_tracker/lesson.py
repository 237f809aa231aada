"""Labelled episodes with the looks at their images, on which whole updates run without rendering or encoding again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from .heads.intercept import KNOTS
from .track import Track

if TYPE_CHECKING:
    from dynahoi_lerobot.onpolicy.rounds import Round

IN_HAND_M = 0.15
"""A target that the hand has touched stays there as long as it is so near."""


@dataclass(frozen=True)
class Lesson:
    """``B`` labelled episodes of up to ``T`` frames, in the frame of ``observation.state``, all on one device.

    Attributes:
        looks: at the images, shape ``(B, T, C, L)``.
        proprioception: all vector observations concatenated, shape ``(B, T, S)``.
        state: ``observation.state``, shape ``(B, T, P)``.
        keep: False once an episode has ended, shape ``(B, T)``.
        watching: the observation window, shape ``(B, T)``.
        path: where the target will be at `KNOTS` after each frame [m], shape ``(B, T, K, 3)``.
        known: False where that lies beyond the known path, shape ``(B, T, K)``.
        closed: joints that close the hand around the target [rad], shape ``(B, T, J)``.
        arrival: frames until the teacher meets the target, shape ``(B, T)``.
        texts: instructions.
        track: where the target of every frame's decision is, ``(B, T, ...)``; it follows from all the others.
    """

    looks: Tensor
    proprioception: Tensor
    state: Tensor
    keep: Tensor
    watching: Tensor
    path: Tensor
    known: Tensor
    closed: Tensor
    arrival: Tensor
    texts: list[str]
    track: Track | None = None

    @classmethod
    def of(cls, played: Round, looks: Sequence[Tensor], proprioception: Sequence[Tensor]) -> Lesson:
        """Put the labels of a round beside what was seen in each of its frames, ``(B, 1, ...)`` each.

        A target that was caught or touched stays where it is; of its untouched path nothing can be seen any more. Where
        one that bounced off the hand will be is not known. All of it is on the device of the looks.
        """
        n_frames = played.playing.shape[1]
        paths, known = zip(*(path_ahead(path, n_frames) for path in played.path), strict=True)
        released = torch.from_numpy(played.released)[..., None]  # (B, T, 1)
        target, state = torch.from_numpy(played.target), torch.from_numpy(played.state)
        near = (target - state[..., :3]).norm(dim=-1, keepdim=True) < IN_HAND_M  # (B, T, 1)
        lesson = cls(
            looks=torch.cat(list(looks), dim=1),
            proprioception=torch.cat(list(proprioception), dim=1),
            state=state,
            keep=torch.from_numpy(played.playing),
            watching=torch.from_numpy(played.watching),
            path=torch.where(released[..., None], target[:, :, None], torch.from_numpy(np.stack(paths))),
            known=torch.where(released, near, torch.from_numpy(np.stack(known))),
            closed=torch.from_numpy(played.closed)[:, None].expand(-1, n_frames, -1),
            arrival=torch.from_numpy(played.arrival),
            texts=list(played.tasks),
        )
        return lesson.to(lesson.looks.device)

    def to(self, device: torch.device | str | None) -> Lesson:
        """Return the lesson on a device."""
        return self._changed(lambda x: x.to(device))

    def seen_ahead(self, lead_frames: Tensor) -> Lesson:
        """Return the lesson of students that had to know where the target is ``lead_frames`` (B,) later, at least.

        What is decided at a frame moves a late hand no earlier, even if the teacher would have met the target before.
        """
        return replace(self, arrival=torch.maximum(self.arrival, lead_frames[:, None]))

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors by name, without those of the track."""
        return {name: value for name, value in vars(self).items() if isinstance(value, Tensor)}

    def rows(self, index: list[int]) -> Lesson:
        """Return some of the episodes, without frames at which none of them is played."""
        rows = torch.tensor(index, device=self.keep.device)
        n_frames = int(self.keep[rows].sum(1).max())
        return replace(self._changed(lambda x: x[rows, :n_frames]), texts=[self.texts[i] for i in index])

    def _changed(self, change: Callable[[Tensor], Tensor]) -> Lesson:
        track = None if self.track is None else self.track.map(change)
        return replace(self, **{name: change(value) for name, value in self.tensors().items()}, track=track)


def path_ahead(path: np.ndarray, n_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (T, K, 3) at `KNOTS` after each of T frames of a path (F, 3), and which of them it holds."""
    index = np.arange(n_frames)[:, None] + np.array(KNOTS)
    return path[index.clip(max=len(path) - 1)], index < len(path)
