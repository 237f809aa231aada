"""Virtual episodes: other hands on the recorded targets' paths, with the sightings that they would have had.

A recording shows the target from where one hand happened to be. A policy soon finds itself elsewhere, so most batches
show hands that follow the teacher badly. What the cameras would have seen from there follows from their calibration,
but for their errors, which are large and last for many frames. Those are resampled from the recordings: each frame
takes the error of a recorded frame in which the target stood at nearly the same place in the image. Training only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from .belief import N_SIGHTING
from .camera import Pinhole
from .lessons import Lesson
from .recordings import Recordings, Targets
from .teacher import answers

if TYPE_CHECKING:
    from .configuration_obact import ObActConfig

POOL, LONGEST_FRAMES = 768, 110
"""Episodes that are made at a time, and how long they are."""
UNITS = (0.25, 0.25, 0.3)
"""Differences in (u, v, log depth) that count as one when recorded frames are compared."""
OWN_CANDIDATES, CANDIDATES = 16, 64
"""Frames of the same and of any recorded episode that are compared."""
FOLLOWING_SHARE, FULL_SPEED_SHARE = 0.6, 0.6
"""Shares of the hands that go where the teacher would go, not after the target, and that move at full speed."""
CHANGE_SHARE = 0.12
"""Share of the frames in which a hand's offset from its goal is redrawn."""
SPREAD_M = 0.15
"""Greatest standard deviation of that offset, along each axis."""
LAG_FRAMES = (-3, 20)
"""Range of how far ahead of the target those go that follow it."""


@dataclass
class ErrorTable:
    """What a camera saw in recorded frames, and what it should have seen.

    Attributes:
        seen: sightings ``(N, 5)``.
        true: ``(u, v, log depth)``, ``(N, 3)``.
        follower: the frame after each, -1 where there is none, ``(N,)``.
        usable: frames before the hand touched the target, ``(M,)``.
    """

    seen: Tensor
    true: Tensor
    follower: Tensor
    usable: Tensor

    def distance(self, frames: Tensor, wanted: Tensor) -> Tensor:
        """Return how far frames ``(..., n)`` are from showing the target at ``wanted`` ``(..., 3)``."""
        return ((_in_view(self.true[frames]) - _in_view(wanted)[..., None, :]) / wanted.new_tensor(UNITS)).norm(dim=-1)

    def nearest(self, frames: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
        """Return the best of frames ``(B, n)`` for ``wanted`` ``(B, 3)``, and how far it is, ``(B,)`` each."""
        distance, best = self.distance(frames, wanted).min(-1)
        return frames.gather(1, best[:, None])[:, 0], distance


def _in_view(seen: Tensor) -> Tensor:
    """Return ``(u, v, log depth)`` with what is far out of view moved to twice the image's half."""
    return torch.cat([seen[..., :2].clamp(-2, 2), seen[..., 2:]], dim=-1)


class VirtualEpisodes:
    """Makes lessons of virtual episodes.

    Args:
        recordings: what was recorded.
        targets: of those.
        cameras: of those.
        step_m: how far a palm gets in a frame [m].
    """

    def __init__(self, recordings: Recordings, targets: Targets, cameras: list[Pinhole], step_m: float) -> None:
        self.recordings, self.targets, self.cameras, self.step_m = recordings, targets, cameras, step_m
        episode = torch.repeat_interleave(torch.arange(len(recordings.frames)), recordings.frames)
        frame = torch.arange(len(episode)) - recordings.first[episode]
        place = targets.path[episode, torch.minimum(frame, targets.length[episode] - 1)]
        usable = frame < targets.free[episode]
        follows = (episode == episode.roll(-1)) & usable.roll(-1)
        follower = torch.where(follows, torch.arange(len(episode)) + 1, -1)
        palm = recordings.state[:, :3]
        self.episode = episode
        self.errors = [
            ErrorTable(recordings.sightings[:, i], cam.seen(place - cam.origin(palm)), follower, usable.nonzero()[:, 0])
            for i, cam in enumerate(cameras)
        ]
        self._waiting: list[Tensor] = []

    def lesson(self, n: int, config: ObActConfig) -> Lesson:
        """Return decisions in ``n`` virtual episodes, see `Recordings.lesson`."""
        if not self._waiting:
            self._chosen = torch.randperm(len(self.recordings.frames))[:POOL]
            self._palm, self._sightings = self._played(self._chosen)
            self._waiting = list(torch.randperm(len(self._chosen)).split(n))
        rows = self._waiting.pop()
        chosen, targets = self._chosen[rows], self.targets.of(self._chosen[rows])
        episodes = self.recordings.seen_otherwise(chosen, targets, self._palm[rows], self._sightings[rows])
        return episodes.lesson(torch.arange(len(rows)), config)

    def _played(self, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """Return palms ``(B, T, 3)`` [m] and sightings ``(B, T, C, 5)`` of hands in episodes ``(B,)``."""
        targets = self.targets.of(chosen)
        path, length = targets.path, targets.length
        hands = _Hands(path, length, self.recordings.window[chosen], self.step_m)
        donors = [_Donors(self, table, len(chosen)) for table in self.errors]
        palms, sightings = [], []
        for t in range(LONGEST_FRAMES):
            place = path[torch.arange(len(path)), (length - 1).clamp_max(t)]
            looks = [
                donor.sighting(cam.seen(place - cam.origin(hands.palm)))
                for donor, cam in zip(donors, self.cameras, strict=True)
            ]
            palms.append(hands.palm)
            sightings.append(torch.stack(looks, dim=1))
            hands.move(t)
        return torch.stack(palms, dim=1), torch.stack(sightings, dim=1)


class _Donors:
    """The recorded frames whose errors the episodes take, as long as they follow each other."""

    def __init__(self, episodes: VirtualEpisodes, table: ErrorTable, n: int) -> None:
        self.table, self.episode, self.recordings = table, episodes.episode, episodes.recordings
        self.available = torch.minimum(self.recordings.frames, episodes.targets.free.clamp_min(1))
        self.source = torch.randint(len(self.recordings.frames), (n,))
        self.frame = torch.full((n,), -1)

    def sighting(self, true: Tensor) -> Tensor:
        """Return what is seen where the target stands at ``(u, v, log depth)`` ``(B, 3)``, ``(B, 5)``."""
        table = self.table
        following = torch.where(self.frame >= 0, table.follower[self.frame], -1)
        keep = (following >= 0) & (table.distance(following.clamp_min(0)[:, None], true)[:, 0] < 1)
        available = self.available[self.source]
        own = (torch.rand(len(true), OWN_CANDIDATES) * available[:, None]).long()
        own, own_distance = table.nearest(self.recordings.first[self.source, None] + own, true)
        any_frame = table.usable[torch.randint(len(table.usable), (len(true), CANDIDATES))]
        other, _ = table.nearest(any_frame, true)
        fresh = torch.where(own_distance < 1, own, other)
        self.frame = torch.where(keep, following, fresh)
        self.source = self.episode[self.frame]
        error = table.seen[self.frame, :3] - table.true[self.frame]
        return torch.cat([true + error, table.seen[self.frame, 3:N_SIGHTING]], dim=-1)


class _Hands:
    """Hands that wait at home and then go to the teacher's goal, or after the target, with an offset of their own."""

    def __init__(self, path: Tensor, length: Tensor, window: Tensor, step_m: float) -> None:
        n = len(path)
        self.path, self.length, self.window, self.full_step_m = path, length, window, step_m
        self.palm = torch.zeros(n, 3)
        self.step_m = torch.where(torch.rand(n) < FULL_SPEED_SHARE, step_m, step_m * (0.3 + 0.7 * torch.rand(n)))
        self.spread_m = SPREAD_M * torch.rand(n, 1) ** 1.5
        self.follows_teacher = torch.rand(n, 1) < FOLLOWING_SHARE
        self.offset, self.lag, self.meeting = torch.zeros(n, 3), torch.zeros(n, dtype=torch.long), torch.zeros(n, 3)

    def move(self, t: int) -> None:
        """Move the palms by a frame, from frame ``t``."""
        n = len(self.palm)
        change = (torch.rand(n) < CHANGE_SHARE) | (self.window == t)
        self.offset = torch.where(change[:, None], torch.randn(n, 3) * self.spread_m, self.offset)
        self.lag = torch.where(change, torch.randint(*LAG_FRAMES, (n,)), self.lag)
        if t % 2 == 0:  # the teacher's answer changes slowly
            due = (self.length - 2).clamp_max(t)[:, None]
            told = answers(self.path, self.length, due, self.palm[:, None, None], self.full_step_m)
            self.meeting = told.meeting[:, 0, 0]
        chased = self.path[torch.arange(n), (t + self.lag).clamp_min(0).minimum(self.length - 1)]
        way = torch.where(self.follows_teacher, self.meeting, chased) + self.offset - self.palm
        share = (self.step_m / way.norm(dim=-1).clamp_min(1e-9)).clamp_max(1.0) * (self.window <= t)
        self.palm = self.palm + way * share[:, None]
