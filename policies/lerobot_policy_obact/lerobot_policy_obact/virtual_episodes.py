"""Virtual episodes: other hands on the recorded targets' paths, with the sightings that they would
have had.

A policy soon finds itself elsewhere than the hand that was recorded, so most batches show hands
that the policy itself leads, or the teacher, pushed off their way now and then. What the cameras
would have seen from there follows from their calibration, but for their errors, which are large and
last for many frames. Each frame takes the error of a recorded frame in which the target stood at
nearly the same place in the image. Training only.
"""

from collections import deque
from copy import deepcopy

import torch
from torch import Tensor
from torch.nn.functional import pad

from .attention import Memory
from .belief import Frames, palm_of, stepped
from .camera import Pinhole
from .decisions import ROLLED_FRAMES, SPREAD, Episodes
from .encoders import N_SIGHTING
from .network import ObActModel
from .recordings import Recordings
from .teacher import NEVER, Targets, Teacher

POOL, USES, LONGEST_FRAMES = (
    384,
    4,
    110,
)  # episodes made at a time, how often each is learned from, how long they are
LED_SHARE = 0.7  # of the hands, that the policy leads; the teacher leads the others
PUSHED_SHARE, CHANGE_SHARE, SPREAD_M = 0.5, 0.12, 0.15
"""Share of the hands that are pushed off their way, of the frames in which by how much is redrawn,
and the greatest standard deviation of that, along each axis."""
HELD_FRAMES = 24  # a hand that holds its target is shown for at most this long
UNITS = (0.25, 0.25, 0.3, 0.5)
"""Differences in (u, v, log depth, how far the fingers are closed) that count as one when frames
are compared."""
OWN_CANDIDATES, CANDIDATES = (
    16,
    64,
)  # frames of the same and of any recorded episode that are compared


class VirtualEpisodes:
    """Makes virtual episodes from recordings with targets, which the cameras saw."""

    def __init__(self, recordings: Recordings, cameras: list[Pinhole]) -> None:
        everyone, teacher, places = recordings.episodes, recordings.teacher, recordings.places
        assert everyone.targets is not None
        assert teacher is not None
        assert places is not None
        self.recordings, self.targets, self.teacher = recordings, everyone.targets, teacher
        self.cameras = [deepcopy(cam).cpu() for cam in cameras]
        frame = torch.arange(everyone.state.shape[1])
        usable = (frame < everyone.count[:, None]) & (
            (frame < self.targets.free[:, None]) | teacher.carries
        )
        self.errors = [
            SightingErrors(
                everyone.sightings[:, :, i],
                self._true(cam, places, everyone.state),
                everyone.count,
                usable,
            )
            for i, cam in enumerate(self.cameras)
        ]
        self._pool: Episodes | None = None
        self._uses = 0

    def draw(self, n: int, model: ObActModel) -> Episodes:
        """Return n virtual episodes of similar length, some of which ``model`` leads."""
        pool = self._pool
        if pool is None or self._uses <= 0 or n * SPREAD > len(pool.count):
            pool = self._pool = self._play(
                self.recordings.named.nonzero()[:, 0], max(POOL, n * SPREAD), model
            )
            self._uses = USES * len(pool.count)
        self._uses -= n
        return pool.similar(torch.randperm(len(pool.count))[: n * SPREAD], n)

    @torch.no_grad()
    def _play(self, known: Tensor, n: int, model: ObActModel) -> Episodes:
        """Return n episodes with targets of ``known`` ones, the longest first, so that the last
        rows are over first.
        """
        chosen = known[torch.randint(len(known), (n,))]
        chosen = chosen[self.targets.length[chosen].argsort(descending=True)]
        everyone, window, teacher = (
            self.targets[chosen],
            self.recordings.episodes.window[chosen],
            self.teacher,
        )
        length = everyone.length.clamp_max(LONGEST_FRAMES)
        hands = _Hands(n, teacher, model)
        for errors in self.errors:
            errors.start(n, known)
        sightings = torch.zeros(n, int(length[0]), len(self.cameras), N_SIGHTING)
        state = torch.zeros(n, len(sightings[0]), self.recordings.episodes.state.shape[-1])
        time_s, thought = torch.arange(len(sightings[0])) / teacher.fps, 0
        for t in range(len(time_s)):
            m = int((length > t).sum())
            targets, acting = everyone[:m], window[:m] <= t
            hands.keep(m)
            state[:m, t] = hands.state(state.shape[-1])
            for i, (cam, errors) in enumerate(zip(self.cameras, self.errors, strict=True)):
                sightings[:m, t, i] = errors.applied(
                    self._true(cam, targets.carried[:, t], state[:m, t])
                )
            before = hands.palm
            if acting.any():  # the frames in which all hands wait are thought about at once
                new = slice(thought, t + 1)
                hands.move(
                    Frames(sightings[:m, new], state[:m, new], time_s[new]), targets, t, window[:m]
                )
                thought = t + 1
            caught = teacher.caught(targets, t, before, hands.palm, hands.closed > 0.5) & acting
            targets.held[caught & (targets.held == NEVER)] = t + 1
            if teacher.carries and t + 1 < targets.carried.shape[1]:
                carried, held = (
                    targets.carried[:, t] + hands.palm - before,
                    (targets.held <= t)[:, None],
                )
                targets.carried[:, t + 1] = torch.where(held, carried, targets.carried[:, t + 1])
        everyone.free.copy_(
            torch.minimum(length, everyone.held + (HELD_FRAMES if teacher.carries else 0))
        )
        needed = torch.minimum(length, everyone.free + ROLLED_FRAMES)
        return Episodes(sightings, state, torch.empty(n, len(time_s), 0), needed, window, everyone)

    def _true(self, camera: Pinhole, place: Tensor, state: Tensor) -> Tensor:
        """Return ``(u, v, log depth)`` of targets at ``(..., 3)`` [m] for robots in states ``(...,
        S)``, and how far the fingers that may hide them are closed, 0 where they hide nothing in
        the end, ``(..., 4)``.
        """
        closed = self.teacher.closed_share(state[..., 3 : 3 + len(self.teacher.open_joints)])[
            ..., None
        ]
        return torch.cat(
            [camera.seen(place - camera.origin(palm_of(state))), closed * self.teacher.carries],
            dim=-1,
        )


class _Hands:
    """Hands that wait at home and then go where the policy or the teacher sends them."""

    def __init__(self, n: int, teacher: Teacher, model: ObActModel) -> None:
        self.teacher, self.model, self.memory = teacher, model, Memory()
        self.palm, self.closed = torch.zeros(n, 3), torch.zeros(n)
        self.led, self.offset = torch.rand(n) < LED_SHARE, torch.zeros(n, 3)
        self.spread_m = SPREAD_M * torch.rand(n, 1) ** 1.5 * (torch.rand(n, 1) < PUSHED_SHARE)
        self.coming = deque(
            [(self.palm, self.closed)] * model.config.rig.delay_frames
        )  # commands on their way

    def keep(self, m: int) -> None:
        """Go on with the first ``m`` hands."""
        self.palm, self.closed, self.led = self.palm[:m], self.closed[:m], self.led[:m]
        self.offset, self.spread_m = self.offset[:m], self.spread_m[:m]
        self.coming = deque((goal[:m], closed[:m]) for goal, closed in self.coming)

    def state(self, size: int) -> Tensor:
        """Return their states, ``(B, size)``."""
        joints = torch.lerp(
            self.teacher.open_joints, self.teacher.closed_joints, self.closed[:, None]
        )
        return pad(torch.cat([self.palm, joints], dim=-1), (0, size - 3 - joints.shape[-1]))

    def move(self, seen: Frames, targets: Targets, t: int, window: Tensor) -> None:
        """Move the hands by a frame, from what they saw in the frames up to ``t`` since they were
        moved last.
        """
        rig, teacher, device = self.model.config.rig, self.teacher, self.model.device
        due = self.palm
        for goal, _ in self.coming:
            due = stepped(due, goal, rig.step_m)
        frame_due = (targets.length - 2).clamp_max(t + rig.delay_frames)[:, None]
        answers = teacher.answer(targets, frame_due, due[:, None, None], 1)
        outlook = self.model.encode_history(seen.to(device), memory=self.memory)
        action = self.model.act_once(
            outlook[:, 0], due.to(device), seen.state[:, -1].to(device)
        ).cpu()
        goal = torch.where(self.led[:, None], action[:, :3], answers.goal[:, 0, 0, 0])
        closed = torch.where(
            self.led, teacher.closed_share(action[:, 3:]), answers.closing[:, 0, 0, 0]
        ).clamp(0, 1)
        change = (torch.rand(len(due)) < CHANGE_SHARE) | (window == t)
        self.offset = torch.where(
            change[:, None], torch.randn_like(due) * self.spread_m, self.offset
        )
        acting = window <= t
        goal = torch.where(acting[:, None], goal + self.offset, due)
        self.coming.append((goal, torch.where(acting, closed, 0.0)))
        goal, self.closed = self.coming.popleft()
        self.palm = stepped(self.palm, goal, rig.step_m)


class SightingErrors:
    """The errors that a camera made in the recorded frames, for episodes in which it might have
    made them too.

    Frames are numbered through all E episodes, each of which has T.

    Args:
        seen: sightings ``(E, T, 5)``.
        true: what should have been seen, see `VirtualEpisodes._true`, ``(E, T, 4)``.
        count: frames of each episode, ``(E,)``.
        usable: whether a frame shows the target as it moves by itself, ``(E, T)``.
    """

    def __init__(self, seen: Tensor, true: Tensor, count: Tensor, usable: Tensor) -> None:
        self.seen, self.true, self.usable = seen.flatten(0, 1), true.flatten(0, 1), usable.flatten()
        self._count, self._n_frames, self._shown = count, usable.shape[1], _in_view(self.true)
        self._last = (len(count) - 1) * self._n_frames + int(count[-1]) - 1

    def start(self, n: int, known: Tensor) -> None:
        """Begin n episodes with the errors of any usable frames of ``known`` episodes."""
        of_known = torch.isin(torch.arange(len(self._count)), known).repeat_interleave(
            self._n_frames
        )
        self._candidates = (of_known & self.usable).nonzero()[:, 0]
        self._frame = self._candidates[torch.randint(len(self._candidates), (n,))]

    def applied(self, true: Tensor) -> Tensor:
        """Return what is seen, ``(B, 5)``, in the next frame of the first B episodes, for what is
        ``true``, ``(B, 4)``.

        The errors are those of the frame that was recorded after the last one, if it shows the
        target near enough to there; else of one of the same episode; else of any.
        """
        n, frame = len(true), self._frame[: len(true)]
        episode, follower = frame // self._n_frames, (frame + 1).clamp_max(self._last)
        follows = self.usable[follower] & (follower // self._n_frames == episode)
        lost = ~(follows & (self._distance(follower[:, None], true)[:, 0] < 1))
        within = (torch.rand(n, OWN_CANDIDATES) * self._count[episode, None]).long()
        own, near = self._nearest((episode[:, None] * self._n_frames + within)[lost], true[lost])
        other = self._candidates[torch.randint(len(self._candidates), (n, CANDIDATES))[lost]]
        follower[lost] = torch.where(near < 1, own, self._nearest(other, true[lost])[0])
        self._frame = follower
        error = self.seen[follower, :3] - self.true[follower, :3]
        return torch.cat([true[:, :3] + error, self.seen[follower, 3:N_SIGHTING]], dim=-1)

    def _nearest(self, frames: Tensor, true: Tensor) -> tuple[Tensor, Tensor]:
        """Return the best of frames ``(B, n)`` for ``true``, and how far it is, ``(B,)`` each."""
        distance, best = self._distance(frames, true).masked_fill(~self.usable[frames], 1e6).min(-1)
        return frames.gather(1, best[:, None])[:, 0], distance

    def _distance(self, frames: Tensor, true: Tensor) -> Tensor:
        """Return how far frames ``(B, n)`` are from showing the target at ``true`` ``(B, 4)``."""
        return (self._shown[frames] - _in_view(true)[:, None]).norm(dim=-1)


def _in_view(seen: Tensor) -> Tensor:
    """Return ``(u, v, log depth, ...)`` in `UNITS`, with what is far out of view moved to twice the
    image's half.
    """
    return torch.cat([seen[..., :2].clamp(-2, 2), seen[..., 2:]], dim=-1) / seen.new_tensor(UNITS)
