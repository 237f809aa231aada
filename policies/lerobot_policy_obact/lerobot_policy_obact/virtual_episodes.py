"""Virtual episodes: other hands on the recorded targets' paths, with the sightings that they would have had.

A recording shows the target from where one hand happened to be. A policy soon finds itself elsewhere, so most batches
show hands that the policy itself leads, or the teacher, pushed off their way now and then. What the cameras would have
seen from there follows from their calibration, but for their errors, which are large and last for many frames. Those
are resampled from the recordings: each frame takes the error of a recorded frame in which the target stood at nearly
the same place in the image. Training only.
"""

from __future__ import annotations

from collections import deque
from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn.functional import pad

from .camera import Pinhole
from .decisions import Episodes
from .encoders import N_SIGHTING
from .frames import Frames, History, stepped
from .recordings import NEVER, SPREAD, Recordings, similar
from .teacher import Targets, Teacher

if TYPE_CHECKING:
    from .modeling_obact import ObActModel

POOL, USES, LONGEST_FRAMES = 384, 4, 110
"""Episodes that are made at a time, how often each is learned from, and how long they are."""
LED_SHARE = 0.7
"""Share of the hands that the policy leads; the teacher leads the others."""
PUSHED_SHARE, CHANGE_SHARE, SPREAD_M = 0.5, 0.12, 0.15
"""Share of the hands that are pushed off their way, of the frames in which by how much is redrawn, and the greatest
standard deviation of that, along each axis."""
HELD_FRAMES = 24
"""A hand that holds its target is shown for at most this long."""
UNITS = (0.25, 0.25, 0.3, 0.5)
"""Differences in (u, v, log depth, how far the fingers are closed) that count as one when frames are compared."""
OWN_CANDIDATES, CANDIDATES = 16, 64
"""Frames of the same and of any recorded episode that are compared."""


class VirtualEpisodes:
    """Makes virtual episodes.

    Args:
        recordings: what was recorded, with targets.
        cameras: of those.
    """

    def __init__(self, recordings: Recordings, cameras: list[Pinhole]) -> None:
        assert recordings.targets is not None
        assert recordings.teacher is not None
        assert recordings.places is not None
        self.recordings, self.targets, self.teacher = recordings, recordings.targets, recordings.teacher
        self.cameras = [deepcopy(cam).cpu() for cam in cameras]
        palm, closed = recordings.state[:, :3], self._closed(recordings.state)
        episode = torch.repeat_interleave(torch.arange(len(recordings.count)), recordings.count)
        frame = torch.arange(len(episode)) - recordings.first[episode]
        usable = (
            torch.ones_like(frame, dtype=torch.bool) if self.teacher.carries else frame < self.targets.free[episode]
        )
        true = [cam.seen(recordings.places - cam.origin(palm)) for cam in self.cameras]
        self.errors = [
            SightingErrors(recordings.sightings[:, i], torch.cat([seen, closed[:, None]], 1), episode, usable)
            for i, seen in enumerate(true)
        ]
        self._pool: Episodes | None = None
        self._uses = 0

    def draw(self, n: int, model: ObActModel) -> Episodes:
        """Return n virtual episodes of similar length, some of which ``model`` leads."""
        pool = self._pool
        if pool is None or self._uses <= 0 or n * SPREAD > len(pool.count):
            pool = self._pool = self._play(self.recordings.named.nonzero()[:, 0], max(POOL, n * SPREAD), model)
            self._uses = USES * len(pool.count)
        self._uses -= n
        rows = similar(torch.randperm(len(pool.count))[: n * SPREAD], pool.count, n)
        t, targets = int(pool.count[rows].max()), pool.targets
        assert targets is not None
        sightings, state, actions = (x[rows, :t] for x in (pool.sightings, pool.state, pool.actions))
        return Episodes(sightings, state, actions, pool.count[rows], pool.window[rows], pool.fps, targets.of(rows))

    @torch.no_grad()
    def _play(self, known: Tensor, n: int, model: ObActModel) -> Episodes:
        """Return n episodes with targets of ``known`` ones."""
        chosen = known[torch.randint(len(known), (n,))]
        targets, window, teacher = self.targets.of(chosen), self.recordings.window[chosen], self.teacher
        hands = _Hands(n, teacher, model)
        frames = [errors.of_any(n, known) for errors in self.errors]
        states, sightings, batch = [], [], torch.arange(n)
        length = targets.length.clamp_max(LONGEST_FRAMES)
        for t in range(int(length.max())):
            place = targets.carried[batch, (targets.length - 1).clamp_max(t)]
            states.append(self._state(hands))
            closed, looks = self._closed(states[-1])[:, None], []
            for i, (errors, cam) in enumerate(zip(self.errors, self.cameras, strict=True)):
                true = torch.cat([cam.seen(place - cam.origin(hands.palm)), closed], dim=-1)
                frames[i] = errors.next(frames[i], true, self.recordings)
                looks.append(errors.applied(frames[i], true))
            sightings.append(torch.stack(looks, dim=1))
            before = hands.palm
            time_s = torch.tensor([t / self.recordings.fps])
            hands.move(Frames(sightings[-1][:, None], states[-1][:, None], time_s), targets, t, window)
            caught = teacher.caught(targets, t, before, hands.palm, hands.closed > 0.5) & (window <= t)
            targets.held[caught & (targets.held == NEVER)] = t + 1
            if teacher.carries and t + 1 < targets.carried.shape[1]:
                carried = targets.carried[:, t] + hands.palm - before
                held = targets.held <= t
                targets.carried[:, t + 1] = torch.where(held[:, None], carried, targets.carried[:, t + 1])
        targets.free.copy_(torch.minimum(length, targets.held + (HELD_FRAMES if teacher.carries else 0)))
        actions = torch.empty(n, len(states), 0)
        seen, state = torch.stack(sightings, 1), torch.stack(states, 1)
        return Episodes(seen, state, actions, length, window, self.recordings.fps, targets)

    def _closed(self, state: Tensor) -> Tensor:
        """Return how far hands in states ``(..., S)`` are closed, ``(...)``; 0 where they hide nothing in the end."""
        joints = state[..., 3 : 3 + len(self.teacher.open_joints)]
        share = self.teacher.closed_share(joints)
        return share if self.teacher.carries else torch.zeros_like(share)

    def _state(self, hands: _Hands) -> Tensor:
        """Return the states of hands, ``(B, S)``."""
        joints = torch.lerp(self.teacher.open_joints, self.teacher.closed_joints, hands.closed[:, None])
        n_rest = self.recordings.state.shape[-1] - 3 - joints.shape[-1]
        return pad(torch.cat([hands.palm, joints], dim=-1), (0, n_rest))


class _Hands:
    """Hands that wait at home and then go where the policy or the teacher sends them."""

    def __init__(self, n: int, teacher: Teacher, model: ObActModel) -> None:
        self.teacher, self.model, self.history = teacher, model, History()
        self.palm, self.closed = torch.zeros(n, 3), torch.zeros(n)
        self.led, self.offset = torch.rand(n) < LED_SHARE, torch.zeros(n, 3)
        self.spread_m = SPREAD_M * torch.rand(n, 1) ** 1.5 * (torch.rand(n, 1) < PUSHED_SHARE)
        self.coming: deque[tuple[Tensor, Tensor]] = deque()

    def move(self, frame: Frames, targets: Targets, t: int, window: Tensor) -> None:
        """Move the hands by a frame, from what they saw in frame ``t``."""
        rig, teacher, device = self.model.config.rig, self.teacher, self.model.device
        due, late = self.palm, rig.delay_frames
        for goal, _ in self.coming:
            due = stepped(due, goal, rig.step_m)
        frame_due = (targets.length - 2).clamp_max(t + late)[:, None]
        told = teacher.answer(targets, frame_due, due[:, None, None], 1)
        outlook = self.history.see(self.model, frame.to(device))
        action = self.model.act_once(outlook.at(0), due.to(device), frame.state[:, 0].to(device)).cpu()
        closed = teacher.closed_share(action[:, 3:])
        goal = torch.where(self.led[:, None], action[:, :3], told.goal[:, 0, 0, 0])
        closed = torch.where(self.led, closed, told.closing[:, 0, 0, 0]).clamp(0, 1)
        change = (torch.rand(len(due)) < CHANGE_SHARE) | (window == t)
        self.offset = torch.where(change[:, None], torch.randn_like(due) * self.spread_m, self.offset)
        acting = window <= t
        goal = torch.where(acting[:, None], goal + self.offset, due)
        self.coming.append((goal, torch.where(acting, closed, 0.0)))
        if len(self.coming) > late:
            goal, self.closed = self.coming.popleft()
            self.palm = stepped(self.palm, goal, rig.step_m)


@dataclass
class SightingErrors:
    """What a camera saw in the N recorded frames, and what it should have seen.

    Attributes:
        seen: sightings ``(N, 5)``.
        true: ``(u, v, log depth)`` and how far the fingers that may hide it are closed, ``(N, 4)``.
        episode: of each, ``(N,)``.
        usable: whether it shows the target as it moves by itself, ``(N,)``.
    """

    seen: Tensor
    true: Tensor
    episode: Tensor
    usable: Tensor

    def of_any(self, n: int, known: Tensor) -> Tensor:
        """Draw n usable frames of ``known`` episodes."""
        frames = (torch.isin(self.episode, known) & self.usable).nonzero()[:, 0]
        self._frames = frames
        return frames[torch.randint(len(frames), (n,))]

    def next(self, frame: Tensor, true: Tensor, recordings: Recordings) -> Tensor:
        """Return frames whose errors come after those of ``frame`` ``(B,)`` if ``true`` ``(B, 4)`` is to be seen.

        That is the frame that was recorded next, if it is near enough; else one of the same episode; else any.
        """
        follower = (frame + 1).clamp_max(len(self.episode) - 1)
        follows = self.usable[follower] & (self.episode[follower] == self.episode[frame])
        keep = follows & (self._distance(follower[:, None], true)[:, 0] < 1)
        episode = self.episode[frame]
        own = (
            recordings.first[episode, None]
            + (torch.rand(len(frame), OWN_CANDIDATES) * recordings.count[episode, None]).long()
        )
        own, near = self._nearest(own, true)
        other, _ = self._nearest(self._frames[torch.randint(len(self._frames), (len(frame), CANDIDATES))], true)
        return torch.where(keep, follower, torch.where(near < 1, own, other))

    def applied(self, frame: Tensor, true: Tensor) -> Tensor:
        """Return what is seen, ``(B, 5)``, with the errors of ``frame`` ``(B,)`` where ``true`` ``(B, 4)`` is."""
        error = self.seen[frame, :3] - self.true[frame, :3]
        return torch.cat([true[:, :3] + error, self.seen[frame, 3:N_SIGHTING]], dim=-1)

    def _nearest(self, frames: Tensor, true: Tensor) -> tuple[Tensor, Tensor]:
        """Return the best of frames ``(B, n)`` for ``true``, and how far it is, ``(B,)`` each."""
        distance, best = self._distance(frames, true).masked_fill(~self.usable[frames], 1e6).min(-1)
        return frames.gather(1, best[:, None])[:, 0], distance

    def _distance(self, frames: Tensor, true: Tensor) -> Tensor:
        """Return how far frames ``(B, n)`` are from showing the target at ``true`` ``(B, 4)``."""
        return ((_in_view(self.true[frames]) - _in_view(true)[:, None]) / true.new_tensor(UNITS)).norm(dim=-1)


def _in_view(seen: Tensor) -> Tensor:
    """Return ``(u, v, log depth, ...)`` with what is far out of view moved to twice the image's half."""
    return torch.cat([seen[..., :2].clamp(-2, 2), seen[..., 2:]], dim=-1)
