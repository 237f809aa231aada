"""What is learned from: decisions in episodes, what should have been done, and the losses. Training
only.

A decision is compared with the answer of a teacher that knows the future (`decision_losses`). But
nothing in imitation tells a policy that a forecast which is wrong now will be less wrong in five
frames. So from a frame on the palm alone is rolled out through the head, each command cut to what a
palm does in a frame, and what counts is how near it comes to catching the target
(`closed_loop_loss`). What is seen meanwhile stays what the hand saw that was there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from einops import rearrange, repeat
from lerobot.utils.constants import ACTION
from torch import Tensor

from .attention import MEMORY_FRAMES
from .belief import FORECAST_FRAMES, Frames, Outlook, Record, gather_frames, palm_of, stepped
from .configuration_obact import ObActConfig
from .network import ObActModel
from .teacher import Targets, Teacher

EARLY_SHARE, EARLIEST_FRAME = 0.15, 3
"""Share of the decisions that are taken anywhere in the observation window, and the first frame at
which."""
UNREACHABLE_WEIGHT = 0.1  # weight of what should be done about a target that is out of reach
SPREAD = 6  # of so many times more episodes than wanted, those of similar length are taken
MISSED_WEIGHT = 10.0
"""Weight in the loss of the distance from the place that attention picks from the forecast to the
right one [1/m]."""


@dataclass(frozen=True)
class Episodes(Record):
    """B episodes of T frames; one that is over repeats its last frame."""

    sightings: Tensor  # see `Frames`, (B, T, C, 5 + E)
    state: Tensor  # of the robot, (B, T, S)
    actions: Tensor  # (B, T, A)
    count: Tensor  # frames of each, (B,)
    window: Tensor  # frames of the observation window, (B,); 0 if there is none
    targets: Targets | None = None  # None if nothing is known of them

    def similar(self, candidates: Tensor, n: int) -> Episodes:
        """Draw n of several times n episodes, which are of similar length and so need little
        padding.
        """
        order = candidates[(self.count[candidates] + torch.rand(len(candidates))).argsort()]
        return self[order.view(-1, n)[torch.randint(len(order) // n, ())]]

    def cut(self, n: int) -> Episodes:
        """Return n consecutive frames of each, drawn anew, and nothing of the targets."""
        start = (torch.rand(len(self.count)) * (self.count - n + 1).clamp_min(1)).long()
        frame = torch.minimum(start[:, None] + torch.arange(n), self.count[:, None] - 1)
        sightings, state, actions = (
            gather_frames(x, frame) for x in (self.sightings, self.state, self.actions)
        )
        return Episodes(
            sightings, state, actions, self.count.clamp_max(n), (self.window - start).clamp_min(0)
        )

    def frames(self, rows: Tensor, fps: float) -> Frames:
        """Return the frames up to the last of ``rows``, recorded at ``fps`` [Hz]."""
        n = int(rows.max()) + 1
        return Frames(self.sightings[:, :n], self.state[:, :n], torch.arange(n) / fps)

    def palm(self, frame: Tensor) -> Tensor:
        """Return where the palm is in frames ``(B, Q)`` [m], ``(B, Q, 3)``."""
        return palm_of(gather_frames(self.state, frame.clamp_max(self.state.shape[1] - 1)))

    def decision_rows(self, n: int, delay: int) -> Tensor:
        """Draw frames at which decisions are taken, ``(B, n)``: mostly where the hand may move."""
        last = self.count - 1 - delay
        if self.targets is not None:
            last = torch.minimum(
                last, torch.minimum(self.targets.length - 3 - delay, self.targets.free - 1)
            )
        last = last.clamp_min(EARLIEST_FRAME + 1)[:, None]
        start = torch.where(
            torch.rand(len(last), n) < EARLY_SHARE, EARLIEST_FRAME, self.window[:, None]
        )
        start = torch.minimum(start, last - 1)
        return torch.minimum(
            start + (torch.rand(start.shape) * (last - start + 0.999)).long(), last
        )

    def decisions(self, rows: Tensor, teacher: Teacher | None, config: ObActConfig) -> Decisions:
        """Return decisions at ``rows`` ``(B, Q)``: what was done there, or the teacher's answers
        for several palms.
        """
        state, delay = gather_frames(self.state, rows)[:, :, None], config.rig.delay_frames
        palm = self.palm(rows + delay)
        if self.targets is None or teacher is None:
            ahead, last = (
                rows[..., None] + torch.arange(config.horizon),
                self.count[:, None, None] - 1,
            )  # (B, Q, H)
            actions, weight = (
                gather_frames(self.actions, torch.minimum(ahead, last)),
                (ahead <= last).float(),
            )
            return Decisions(palm[:, :, None], state, actions[:, :, None], weight[:, :, None])
        targets = self.targets
        due = torch.minimum(rows + delay, targets.length[:, None] - 2)
        palms = teacher.palms(targets, due, palm)
        answers = teacher.answer(targets, due, palms, config.horizon)
        index = rows[..., None] + torch.tensor(FORECAST_FRAMES)
        weight = torch.where(answers.reachable, 1.0, UNREACHABLE_WEIGHT)
        return Decisions(
            palm=palms,
            state=state.expand(-1, -1, palms.shape[2], -1),
            actions=torch.cat([answers.goal, teacher.joints(answers.closing)], dim=-1),
            weight=repeat(weight, "b q m -> b q m h", h=config.horizon),
            future=Future(
                place=targets.places(index, rows),
                known=index < targets.length[:, None, None],
                near=_nearness(answers.frames + delay, answers.reachable),
            ),
        )


@dataclass(frozen=True)
class Future(Record):
    """Where the target will be at the K times of a forecast."""

    place: Tensor  # there [m], (B, Q, K, 3)
    known: Tensor  # which of those are known, (B, Q, K)
    near: Tensor  # weight of each time by how near it is to the meeting, (B, Q, K)

    def loss(self, forecast: Tensor, ahead_s: Tensor) -> Tensor:
        """Return the loss of forecasts ``(B, Q, K, 3)`` [m] by episode, ``(B,)``; it is largest
        near the meeting.
        """
        error = ((forecast - self.place).square().sum(-1) + 1e-8).sqrt() * self.known
        return (error / (0.05 + 0.3 * ahead_s)).mean((1, 2)) + 10 * (error * self.near).sum(
            -1
        ).mean(1)


def _nearness(frames: Tensor, reachable: Tensor) -> Tensor:
    """Return the weight of each time of the forecast for meetings in ``frames`` ``(B, Q, M)``,
    ``(B, Q, K)``.
    """
    left = frames.clamp_max(FORECAST_FRAMES[-1]).float()[..., None]
    weight = (1 - (torch.tensor(FORECAST_FRAMES) - left).abs() / (1 + 0.25 * left)).clamp_min(0)
    return (weight / weight.sum(-1, keepdim=True).clamp_min(1e-6) * reachable[..., None]).mean(2)


@dataclass(frozen=True)
class Decisions(Record):
    """What Q decisions in each of B episodes should have been, from each of M palms."""

    palm: Tensor  # where the palm is when the command takes effect [m], (B, Q, M, 3)
    state: Tensor  # of the robot, (B, Q, M, S)
    actions: Tensor  # the right ones, (B, Q, M, H, A)
    weight: Tensor  # of each, 0 for padding, (B, Q, M, H)
    future: Future | None = None  # where the target will be; None if nobody knows


def decision_losses(model: ObActModel, outlook: Outlook, decisions: Decisions) -> dict[str, Tensor]:
    """Return the losses of forecast and action by episode, ``(B,)`` each."""
    losses, n, m = {}, len(outlook.features), decisions.palm.shape[2]
    if decisions.future is not None:
        losses["forecast"] = decisions.future.loss(outlook.forecast, model.belief.ahead_s)
    palm, state, actions, weight = (
        x.flatten(0, 2)
        for x in (decisions.palm, decisions.state, decisions.actions, decisions.weight)
    )
    outlook = replace(outlook, weights=None).map(lambda x: repeat(x, "b q ... -> (b q m) ...", m=m))
    context, origin = model.condition(outlook, palm, state)
    loss = model.head.loss(
        context, model.normalise(actions, origin.detach()), weight
    )  # (B * Q * M,)
    losses["action"] = rearrange(loss, "(b n) -> b n", b=n).mean(1)
    if decisions.future is not None:
        missed = (
            (actions[..., :3] - origin).square().sum(-1) + 1e-8
        ).sqrt()  # by the place that was picked
        losses["missed"] = MISSED_WEIGHT * rearrange(
            (missed * weight).mean(-1), "(b n) -> b n", b=n
        ).mean(1)
    return losses


# -- the closed loop -------------------------------------------------------------------------------

ROLLED_FRAMES = 24  # a palm is rolled out for so long
# share of the palms that start anywhere before the catch; the others start with the control phase
LATE_SHARE = 0.5
RIM, SOFTNESS, FAR_M, FAR_WEIGHT = 0.9, 0.27, 0.1, 0.3
"""The loss is a smooth step at this share of the radius within which a target is caught, so wide in
radii, and a part of the distance beyond, in this unit."""


def rolled_rows(episodes: Episodes, delay: int) -> Tensor:
    """Draw the frames of the decisions through which palms are rolled out, ``(B, R)``."""
    targets = episodes.targets
    assert targets is not None
    known = torch.minimum(targets.length, episodes.count)
    first = (episodes.window - delay).clamp_min(EARLIEST_FRAME)
    last = torch.minimum(known - 4, torch.minimum(targets.free, targets.held) - 1) - delay
    anywhere = first + (torch.rand(len(first)) * (last - first).clamp_min(0)).long()
    start = torch.where(torch.rand(len(first)) < LATE_SHARE, anywhere, first)
    start = torch.minimum(start, (known - 4 - delay).clamp_min(EARLIEST_FRAME))
    return torch.minimum(start[:, None] + torch.arange(ROLLED_FRAMES), (known - 2)[:, None])


def closed_loop_loss(
    model: ObActModel, outlook: Outlook, episodes: Episodes, rows: Tensor, teacher: Teacher
) -> Tensor:
    """Return the loss of each episode, ``(B,)``, from what the model believes at ``rows`` ``(B,
    R)``.
    """
    targets, rig, device = episodes.targets, model.config.rig, model.device
    assert targets is not None
    due = rows[:, :1] + rig.delay_frames + torch.arange(rows.shape[1] + 1)  # (B, R + 1)
    known = (due[:, :-1] < torch.minimum(targets.length, episodes.count)[:, None] - 1).to(device)
    path = gather_frames(targets.path, torch.minimum(due, targets.length[:, None] - 1)).to(device)
    palm, state = (
        episodes.palm(due[:, :1])[:, 0].to(device),
        gather_frames(episodes.state, rows[:, 0]).to(device),
    )
    offsets = [palm - path[:, 0]]
    for r in range(rows.shape[1]):
        palm = stepped(palm, model.act_once(outlook[:, r], palm, state)[:, :3], rig.step_m)
        offsets.append(palm - path[:, r + 1])
    misses = teacher.misses(torch.stack(offsets, dim=1))  # (B, R')
    known = known[:, : misses.shape[1]]
    least = misses.masked_fill(~known, torch.inf).amin(1)
    least = least.where(least.isfinite(), 0.0)
    step = torch.sigmoid((least / teacher.radius_m - RIM) / SOFTNESS)
    return (step + FAR_WEIGHT * (least / FAR_M).clamp_max(2.0)) * known.any(1)


# -- the losses of a batch -------------------------------------------------------------------------


def episode_losses(
    model: ObActModel, episodes: Episodes, teacher: Teacher | None
) -> dict[str, Tensor]:
    """Return the losses of encoded episodes, ``(B,)`` each; without a teacher those of the recorded
    actions alone.
    """
    config, device = model.config, model.device
    n, delay = config.n_decisions, config.rig.delay_frames
    if teacher is None and episodes.state.shape[1] > MEMORY_FRAMES:
        episodes = episodes.cut(MEMORY_FRAMES)  # while acting, too, no more is remembered
    rows = episodes.decision_rows(n, delay)
    decisions = episodes.decisions(rows, teacher, config)
    closes = teacher is not None and config.closed_loop_weight > 0
    rolled = rolled_rows(episodes, delay) if closes else rows[:, :0]
    seen = torch.cat([rows, rolled], dim=1)
    outlook = model.encode_history(
        episodes.frames(seen, config.rig.fps).to(device), seen.to(device)
    )
    losses = decision_losses(model, outlook[:, :n], decisions.to(device))
    if teacher is not None and closes:
        losses["closed_loop"] = closed_loop_loss(model, outlook[:, n:], episodes, rolled, teacher)
    return losses


def window_losses(model: ObActModel, batch: dict[str, Any]) -> dict[str, Tensor]:
    """Return the losses of decisions at the end of LeRobot's windows of images, ``(B,)`` each."""
    config, offsets = model.config, model.config.observation_delta_indices or []
    at = [offsets.index(offset) for offset in config.lookback]
    before = [offsets.index(offset - 1) for offset in config.lookback] if config.sees_motion else at
    images = (
        {key: batch[key][:, index].flatten(0, 1) for key in config.cameras}
        for index in (at, before)
    )
    sightings = rearrange(model.encode_images(*images), "(b t) ... -> b t ...", t=len(at))
    state = torch.cat([batch[key][:, at] for key in config.state_keys], dim=-1)
    frames = Frames(
        sightings, state, torch.tensor(config.lookback, device=state.device) / config.rig.fps
    )
    actions, padding = batch[ACTION], batch.get(f"{ACTION}_is_pad")
    weight = (
        torch.ones(actions.shape[:2], device=state.device)
        if padding is None
        else (~padding).float()
    )
    palm, now = frames.palm[:, -1:, None], frames.state[:, -1:, None]
    decisions = Decisions(palm, now, actions[:, None, None], weight[:, None, None])
    return decision_losses(model, model.encode_history(frames), decisions)
