"""Virtual episodes: other hands on the recorded targets' paths, with the sightings that they would have had.

A recording shows the target from where one hand happened to be. A policy soon finds itself elsewhere, so most batches
show hands that follow the teacher badly. What the cameras would have seen from there follows from their calibration,
but for their errors, which are large and last for many frames. Those are resampled from the recordings: each frame
takes the error of a recorded frame in which the target stood at nearly the same place in the image. Training only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn.functional import pad

from .camera import Pinhole
from .decisions import Decisions
from .encoders import N_SIGHTING
from .grips import GrippingHands
from .recordings import Recordings, Targets
from .teacher import answers

if TYPE_CHECKING:
    from .configuration_obact import ObActConfig

POOL, LONGEST_FRAMES = 768, 110
"""Episodes that are made at a time, and how long they are."""
UNITS = (0.25, 0.25, 0.3, 0.5)
"""Differences in (u, v, log depth, how far the fingers are closed) that count as one when frames are compared."""
OWN_CANDIDATES, CANDIDATES = 16, 64
"""Frames of the same and of any recorded episode that are compared."""
FOLLOWING_SHARE, FULL_SPEED_SHARE = 0.6, 0.6
"""Shares of the hands that go where the teacher would go, not after the target, and that move at full speed."""
CHANGE_SHARE = 0.12
"""Share of the frames in which a hand's offset from its goal is redrawn."""
SPREAD_M = 0.15
"""Greatest standard deviation of that offset, along each axis."""
JOINT_SPREAD = 0.1
"""Standard deviation of how far fingers get that close on a target, relative to the closed pose."""
LAG_FRAMES = (-3, 20)
"""Range of how far ahead of the target those go that follow it."""


@dataclass
class ErrorTable:
    """What a camera saw in recorded frames, and what it should have seen.

    Attributes:
        seen: sightings ``(N, 5)``.
        true: ``(u, v, log depth)`` and how far the fingers that may hide it are closed, ``(N, 4)``.
        follower: the frame after each, -1 where there is none, ``(N,)``.
        usable: frames before the hand touched the target, ``(M,)``.
    """

    seen: Tensor
    true: Tensor
    follower: Tensor
    usable: Tensor

    def distance(self, frames: Tensor, wanted: Tensor) -> Tensor:
        """Return how far frames ``(..., n)`` are from showing the target at ``wanted`` ``(..., 4)``."""
        return ((_in_view(self.true[frames]) - _in_view(wanted)[..., None, :]) / wanted.new_tensor(UNITS)).norm(dim=-1)

    def nearest(self, frames: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
        """Return the best of frames ``(B, n)`` for ``wanted`` ``(B, 4)``, and how far it is, ``(B,)`` each."""
        distance, best = self.distance(frames, wanted).min(-1)
        return frames.gather(1, best[:, None])[:, 0], distance


def _in_view(seen: Tensor) -> Tensor:
    """Return ``(u, v, log depth)`` with what is far out of view moved to twice the image's half."""
    return torch.cat([seen[..., :2].clamp(-2, 2), seen[..., 2:]], dim=-1)


class VirtualEpisodes:
    """Makes virtual episodes, and draws decisions in them.

    Args:
        recordings: what was recorded.
        targets: of those.
        cameras: of those.
        step_m: how far a palm gets in a frame [m].
        grips: whether targets are gripped, by hands that follow `GrippingHands`.
    """

    def __init__(
        self, recordings: Recordings, targets: Targets, cameras: list[Pinhole], step_m: float, *, grips: bool
    ) -> None:
        self.recordings, self.targets, self.cameras = recordings, targets, cameras
        self.step_m, self.grips = step_m, grips
        episode = torch.repeat_interleave(torch.arange(len(recordings.frames)), recordings.frames)
        frame = torch.arange(len(episode)) - recordings.first[episode]
        place = targets.path[episode, torch.minimum(frame, targets.length[episode] - 1)]
        usable = frame < targets.free[episode]
        closed = torch.zeros(len(episode), 1)
        if recordings.places is not None:
            place, usable = recordings.places, torch.ones_like(usable)
            closed = targets.closed_share(recordings.state)[:, None]
        follows = (episode == episode.roll(-1)) & usable.roll(-1)
        follower = torch.where(follows, torch.arange(len(episode)) + 1, -1)
        palm = recordings.state[:, :3]
        self.episode = episode
        self.errors = [
            ErrorTable(
                recordings.sightings[:, i],
                torch.cat([cam.seen(place - cam.origin(palm)), closed], -1),
                follower,
                usable.nonzero()[:, 0],
            )
            for i, cam in enumerate(cameras)
        ]
        self._waiting = torch.empty(0, dtype=torch.long)

    def decisions(self, n: int, config: ObActConfig) -> Decisions:
        """Return decisions in ``n`` virtual episodes, see `Recordings.decisions`."""
        if len(self._waiting) < n:
            known = self.recordings.known
            self._chosen = known[torch.randint(len(known), (max(POOL, n),))]
            self._played_targets, self._state, self._sightings = self._played(self._chosen)
            self._waiting = torch.randperm(len(self._chosen))
        rows, self._waiting = self._waiting[:n], self._waiting[n:]
        chosen, targets = self._chosen[rows], self._played_targets.of(rows)
        episodes = self.recordings.seen_otherwise(chosen, targets, self._state[rows], self._sightings[rows])
        return episodes.decisions(torch.arange(len(rows)), config)

    def _played(self, chosen: Tensor) -> tuple[Targets, Tensor, Tensor]:
        """Return targets, states ``(B, T, S)`` and sightings ``(B, T, C, 5)`` of hands in episodes ``(B,)``."""
        targets, window = self.targets.of(chosen), self.recordings.window[chosen]
        hands = GrippingHands(targets, window, self.step_m) if self.grips else _Hands(targets, window, self.step_m)
        donors = [_Donors(self, table, len(chosen)) for table in self.errors]
        states, sightings = [], []
        for t in range(LONGEST_FRAMES):
            place = hands.place(t)
            looks = [
                donor.sighting(torch.cat([cam.seen(place - cam.origin(hands.palm)), hands.closed[:, None]], dim=-1))
                for donor, cam in zip(donors, self.cameras, strict=True)
            ]
            states.append(self._state_of(hands.palm, hands.closed))
            sightings.append(torch.stack(looks, dim=1))
            hands.move(t)
        return hands.targets, torch.stack(states, dim=1), torch.stack(sightings, dim=1)

    def _state_of(self, palm: Tensor, closed: Tensor) -> Tensor:
        """Return states ``(B, S)`` of palms ``(B, 3)`` [m] and hands closed by ``(B,)``."""
        n_rest = self.recordings.state.shape[-1] - palm.shape[-1]
        if not self.grips:
            return pad(palm, (0, n_rest))
        share = closed[:, None] * (1 + JOINT_SPREAD * torch.randn(len(palm), 1))
        joints = torch.lerp(self.targets.open_joints, self.targets.closed_joints, share)
        return pad(torch.cat([palm, joints], dim=-1), (0, n_rest - joints.shape[-1]))


class _Donors:
    """The recorded frames whose errors the episodes take, as long as they follow each other."""

    def __init__(self, episodes: VirtualEpisodes, table: ErrorTable, n: int) -> None:
        self.table, self.episode, self.recordings = table, episodes.episode, episodes.recordings
        self.available = torch.minimum(self.recordings.frames, episodes.targets.free.clamp_min(1))
        known = self.recordings.known
        self.usable = table.usable[self.recordings.named[self.episode[table.usable]]]
        self.source = known[torch.randint(len(known), (n,))]
        self.frame = torch.full((n,), -1)

    def sighting(self, true: Tensor) -> Tensor:
        """Return what is seen, ``(B, 5)``; ``true`` is what should be, as in `ErrorTable`, ``(B, 4)``."""
        table = self.table
        following = torch.where(self.frame >= 0, table.follower[self.frame], -1)
        keep = (following >= 0) & (table.distance(following.clamp_min(0)[:, None], true)[:, 0] < 1)
        available = self.available[self.source]
        own = (torch.rand(len(true), OWN_CANDIDATES) * available[:, None]).long()
        own, own_distance = table.nearest(self.recordings.first[self.source, None] + own, true)
        any_frame = self.usable[torch.randint(len(self.usable), (len(true), CANDIDATES))]
        other, _ = table.nearest(any_frame, true)
        fresh = torch.where(own_distance < 1, own, other)
        self.frame = torch.where(keep, following, fresh)
        self.source = self.episode[self.frame]
        error = table.seen[self.frame, :3] - table.true[self.frame, :3]
        return torch.cat([true[:, :3] + error, table.seen[self.frame, 3:N_SIGHTING]], dim=-1)


class _Hands:
    """Hands that wait at home and then go to the teacher's goal, or after the target, with an offset of their own."""

    def __init__(self, targets: Targets, window: Tensor, step_m: float) -> None:
        n, self.targets = len(targets.path), replace(targets, free=targets.length)
        self.path, self.length, self.window, self.full_step_m = targets.path, targets.length, window, step_m
        self.palm, self.closed = torch.zeros(n, 3), torch.zeros(n)
        self.step_m = torch.where(torch.rand(n) < FULL_SPEED_SHARE, step_m, step_m * (0.3 + 0.7 * torch.rand(n)))
        self.spread_m = SPREAD_M * torch.rand(n, 1) ** 1.5
        self.follows_teacher = torch.rand(n, 1) < FOLLOWING_SHARE
        self.offset, self.lag, self.meeting = torch.zeros(n, 3), torch.zeros(n, dtype=torch.long), torch.zeros(n, 3)

    def place(self, t: int) -> Tensor:
        """Return where the targets are in frame ``t`` [m], ``(B, 3)``."""
        return self.path[torch.arange(len(self.path)), (self.length - 1).clamp_max(t)]

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
