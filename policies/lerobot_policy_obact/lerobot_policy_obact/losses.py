"""What is learned in a window: where the target will be, what should be done, and to catch it.

A decision is compared with the answer of a teacher that knows the future (`decision_losses`). But
nothing in imitation tells a policy that a forecast which is wrong now will be less wrong in five
frames. So from some frame on a palm is moved by what the head decides in each frame, as far as its
speed allows, and what counts is how near it comes to catching the target (`closed_loop_loss`). Only
the palm is played: the forecasts that the head reads are from the sightings of the window, those of
another hand, and do not change with where the palm gets to. Training only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from einops import rearrange, repeat
from torch import Tensor

from .configuration_obact import ObActConfig
from .forecaster import FORECAST_FRAMES, Forecast, GrowingUnit
from .frames import Record, gather_frames, palm_of
from .network import ObActModel, rolled_out
from .teacher import Teacher
from .windows import Window

UNREACHABLE_WEIGHT = 0.1  # weight of what should be done about a target that is out of reach
MISSED_WEIGHT = 10.0
"""Weight in the loss of the distance from the place that attention picks from the forecast to the
right one [1/m]: 10 cm count as one. Not tuned."""
FORECAST_ERROR = GrowingUnit(0.05, 0.3)  # in which errors of the forecast count
INTERCEPT_WEIGHT = 10.0  # weight of the error of the forecast near the intercept [1/m]
INTERCEPT_SPREAD = 0.25  # times are near an intercept within this share of the time left until then
RIM = 0.9
SOFTNESS = 0.27
"""The closed loop's loss is a smooth step: a sigmoid of the distance in radii within which a target
is caught, around the first number, with the second as its width. A palm at the rim itself counts
for 0.6."""
DISTANCE_UNIT_M = 0.1
DISTANCE_WEIGHT = 0.3
LARGEST_DISTANCE = 2.0
"""To the step comes the distance in this unit, with this weight and at most so many units, which
leads palms that are far off. Not tuned, as the step is not."""
LEAST_ROLLED = 4  # frames through which a palm is rolled out, at least, if a window has as many


def window_losses(model: ObActModel, window: Window, teacher: Teacher | None) -> dict[str, Tensor]:
    """Return the losses of windows, ``(B,)`` each; without a teacher that of the recorded actions
    alone.
    """
    config = model.config
    n_frames = window.recorded.shape[1]
    now = torch.full_like(window.begin, config.n_obs_steps - 1)[:, None]
    if teacher is None or window.targets is None:
        palm = gather_frames(window.frames.palm, now)
        state = gather_frames(window.frames.state, now)
        decisions = Decisions(
            palm[:, :, None],
            state[:, :, None],
            window.actions[:, None, None],
            window.action_weight[:, None, None],
        )
        return decision_losses(model, model.encode_history(window.frames, now), decisions)
    late = window.delay_frames
    targets = window.targets
    # the last decision takes effect before the catch, in the window, and with two known frames of
    # the target's path, in which to meet it, still to come
    last = torch.minimum(targets.free, targets.length - 2).clamp_max(n_frames) - 1 - late
    spread = torch.rand(len(now), config.n_decisions, device=now.device)
    rows = now + (spread * (last[:, None] - now + 1).clamp_min(0)).long()
    latest = max(config.n_obs_steps, n_frames - LEAST_ROLLED - late) - 1
    first = window.begin[:, None].clamp(min=now).clamp_max(latest)
    rolled = first + torch.arange(config.n_future_steps, device=now.device)
    rolled = rolled.clamp_max(n_frames - 1)
    decided = torch.cat([rows, rolled], dim=1) if config.n_future_steps else rows
    forecast = model.encode_history(window.frames, decided)
    decisions = decisions_at(window, rows, teacher, config)
    losses = decision_losses(model, forecast[:, : config.n_decisions], decisions)
    if config.n_future_steps and config.closed_loop_weight:
        rolled_forecast = forecast[:, config.n_decisions :].later(late)
        losses["closed_loop"] = closed_loop_loss(model, rolled_forecast, window, rolled, teacher)
    return losses


# -- decisions -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Future(Record):
    """Where the target will be at the K times of a forecast."""

    place: Tensor  # there [m], (B, Q, K, 3)
    known: Tensor  # which of those are known, (B, Q, K)
    near: Tensor  # weight of each time by how near it is to the intercept, (B, Q, K)

    def loss(self, forecast: Tensor, ahead_s: Tensor) -> Tensor:
        """Return the loss of forecasts ``(B, Q, K, 3)`` [m] by window, ``(B,)``."""
        error = ((forecast - self.place).square().sum(-1) + 1e-8).sqrt() * self.known
        anywhere = (error / FORECAST_ERROR.at(ahead_s)).mean((1, 2))
        return anywhere + INTERCEPT_WEIGHT * (error * self.near).sum(-1).mean(1)


@dataclass(frozen=True)
class Decisions(Record):
    """What Q decisions in each of B windows should have been, from each of M palms."""

    palm: Tensor  # where the palm is when the command takes effect [m], (B, Q, M, 3)
    state: Tensor  # of the robot, (B, Q, M, S)
    actions: Tensor  # the right ones, (B, Q, M, H, A)
    weight: Tensor  # of each, 0 for padding, (B, Q, M, H)
    delay_frames: int = 0  # until the commands take effect
    future: Future | None = None  # where the target will be; None if nobody knows


def decisions_at(window: Window, rows: Tensor, teacher: Teacher, config: ObActConfig) -> Decisions:
    """Return the teacher's answers to decisions at ``rows`` ``(B, Q)``, for several palms."""
    targets = window.targets
    late = window.delay_frames
    assert targets is not None
    last = window.recorded.shape[1] - 1
    palm = gather_frames(window.frames.palm, (rows + late).clamp_max(last))
    # at the latest in the last frame but one that is known: a teacher looks a frame ahead
    due = torch.minimum(rows + late, targets.length[:, None] - 2)
    palms = teacher.palms(targets, due, palm)
    answers = teacher.answer(targets, due, palms, config.horizon)
    index = rows[..., None] + torch.tensor(FORECAST_FRAMES, device=rows.device)
    weight = torch.where(answers.reachable, 1.0, UNREACHABLE_WEIGHT)
    # nothing is decided that would take effect after the catch
    weight = weight * (rows + late < targets.free[:, None])[..., None]
    state = gather_frames(window.frames.state, rows)[:, :, None]
    return Decisions(
        palm=palms,
        state=state.expand(-1, -1, palms.shape[2], -1),
        actions=torch.cat([answers.goal, teacher.joints(answers.closing)], dim=-1),
        weight=repeat(weight, "b q m -> b q m h", h=config.horizon),
        delay_frames=late,
        future=Future(
            place=targets.places(index),
            known=index < targets.length[:, None, None],
            near=_nearness(answers.frames + late, answers.reachable),
        ),
    )


def _nearness(frames: Tensor, reachable: Tensor) -> Tensor:
    """Return the weight of each time of the forecast for intercepts in ``frames`` ``(B, Q, M)``,
    ``(B, Q, K)``.
    """
    times = torch.tensor(FORECAST_FRAMES, device=frames.device)
    left = frames.clamp_max(FORECAST_FRAMES[-1]).float()[..., None]
    weight = (1 - (times - left).abs() / (1 + INTERCEPT_SPREAD * left)).clamp_min(0)
    return (weight / weight.sum(-1, keepdim=True).clamp_min(1e-6) * reachable[..., None]).mean(2)


def decision_losses(
    model: ObActModel, forecast: Forecast, decisions: Decisions
) -> dict[str, Tensor]:
    """Return the losses of forecast and action by window, ``(B,)`` each."""
    losses = {}
    n_windows = len(forecast.features)
    n_palms = decisions.palm.shape[2]
    if decisions.future is not None:
        losses["forecast"] = decisions.future.loss(forecast.places, model.forecaster.ahead_s)
    palm, state, actions, weight = (
        x.flatten(0, 2)
        for x in (decisions.palm, decisions.state, decisions.actions, decisions.weight)
    )
    forecast = replace(forecast.later(decisions.delay_frames), attention=None).map(
        lambda x: repeat(x, "b q ... -> (b q m) ...", m=n_palms)
    )
    context, origin = model.condition(forecast, palm, state)
    # (B * Q * M,)
    loss = model.head.loss(context, model.normalize(actions, origin.detach()), weight)
    losses["action"] = rearrange(loss, "(b n) -> b n", b=n_windows).mean(1)
    if decisions.future is not None:
        # by the place that was picked
        missed = ((palm_of(actions) - origin).square().sum(-1) + 1e-8).sqrt()
        missed = rearrange((missed * weight).mean(-1), "(b n) -> b n", b=n_windows)
        losses["missed"] = MISSED_WEIGHT * missed.mean(1)
    return losses


# -- the closed loop -------------------------------------------------------------------------------


def closed_loop_loss(
    model: ObActModel, forecast: Forecast, window: Window, rows: Tensor, teacher: Teacher
) -> Tensor:
    """Return the loss of each window, ``(B,)``, for palms that are rolled out through decisions at
    frames ``rows`` ``(B, R)``; the forecast counts from when these take effect.
    """
    targets = window.targets
    late = window.delay_frames
    assert targets is not None
    n_frames = window.recorded.shape[1]
    device = rows.device
    due = rows[:, :1] + late + torch.arange(rows.shape[1] + 1, device=device)  # (B, R + 1)
    # a palm passes the target between a frame and the next one, which must be known as well
    known = (due[:, :-1] < targets.length[:, None] - 1) & (due[:, :-1] < n_frames)
    path = gather_frames(targets.path, due.clamp_max(targets.path.shape[1] - 1))
    palm = gather_frames(window.frames.palm, due[:, :1].clamp_max(n_frames - 1))
    state = gather_frames(window.frames.state, rows[:, 0])
    way = rolled_out(model, forecast, palm, state)
    misses = teacher.misses(way - path)  # (B, R)
    least = misses.masked_fill(~known, torch.inf).amin(1)
    least = least.where(least.isfinite(), 0.0)
    step = torch.sigmoid((least / teacher.radius_m - RIM) / SOFTNESS)
    distance = (least / DISTANCE_UNIT_M).clamp_max(LARGEST_DISTANCE)
    return (step + DISTANCE_WEIGHT * distance) * known.any(1)
