"""What is learned in a window: where the target will be, what should be done, and to catch it.

A decision is compared with the answer of a teacher that knows the future (`decision_losses`). But
nothing in imitation tells a policy that a forecast which is wrong now will be less wrong in five
frames. So from some frame on a palm is moved by what the head decides in each frame, as far as its
speed allows, and what counts is how near it comes to catching the target (`closed_loop_loss`). Only
the hand is played: the forecasts that the head reads are from the sightings of the window, those of
another hand, and do not change with where the palm gets to. Training only.
"""

from __future__ import annotations

import torch
from einops import rearrange, repeat
from torch import Tensor

from .forecaster import FORECAST_FRAMES, Forecast, GrowingUnit
from .frames import gather_frames, palm_of
from .layers import smooth_norm
from .network import ObActModel, rolled_out
from .teacher import Targets, Teacher
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
is caught, around the first number, with the second as its width. A palm that is exactly one radius
away counts for 0.6."""
DISTANCE_UNIT_M = 0.1
DISTANCE_WEIGHT = 0.3
LARGEST_DISTANCE = 2.0
"""To the step comes the distance in this unit, with this weight and at most so many units, which
leads palms that are far off. Not tuned, as the step is not."""


def window_losses(model: ObActModel, window: Window, teacher: Teacher | None) -> dict[str, Tensor]:
    """Return the losses of windows, ``(B,)`` each; without a teacher that of the recorded actions
    alone.
    """
    config = model.config
    targets = window.targets
    if teacher is None or targets is None:
        return {"action": recorded_loss(model, window)}
    first = first_decision(window, config.n_obs_steps)[:, None]
    imitated_at = _imitated(model, window, targets, first)
    rolled_at = first + torch.arange(config.n_future_steps, device=first.device)
    # after the window's last frame, decisions are taken from the forecast of that frame
    beyond = (rolled_at - (window.n_frames - 1)).clamp_min(0)
    closes_loop = config.n_future_steps > 0 and config.closed_loop_weight > 0
    decided_at = [imitated_at, rolled_at - beyond] if closes_loop else [imitated_at]
    forecast = model.encode_history(window.frames, torch.cat(decided_at, dim=1))
    imitated = forecast[:, : config.n_decisions]
    losses = decision_losses(model, imitated, window, imitated_at, teacher)
    if closes_loop:
        rolled = forecast[:, config.n_decisions :].later(window.delay_frames + beyond)
        losses["closed_loop"] = closed_loop_loss(model, rolled, window, rolled_at, teacher)
    return losses


def _imitated(model: ObActModel, window: Window, targets: Targets, first: Tensor) -> Tensor:
    """Draw the frames of the decisions that are imitated, ``(B, Q)``, from the ``first`` ones on,
    ``(B, 1)``.
    """
    config = model.config
    # the last one takes effect before the catch, in the window, and with two known frames of the
    # target's path, in which to meet it, still to come
    last = torch.minimum(targets.catch, targets.length - 2).clamp_max(window.n_frames)
    last = last[:, None] - 1 - window.delay_frames
    share = torch.rand(len(first), config.n_decisions, device=first.device)
    drawn = first + (share * (last - first + 1).clamp_min(0)).long()
    # a hand that grips the target learns the recorded actions, which are those of the current frame
    return torch.where(targets.gripped[:, None], config.n_obs_steps - 1, drawn)


def first_decision(window: Window, n_obs_steps: int) -> Tensor:
    """Return the frame of a window in which its first decision is taken, ``(B,)``: the one whose
    command first moves the hand, or a later one that has seen ``n_obs_steps`` frames or the whole
    episode so far.
    """
    earliest = torch.full_like(window.begin, n_obs_steps - 1)
    hidden = window.frames.hidden
    # where some are hidden, the first that is not is the episode's first
    earliest = torch.where(hidden.any(1), hidden.sum(1), earliest)
    last = window.n_frames - 1
    return torch.maximum(window.begin.clamp_max(last) - window.delay_frames, earliest)


def recorded_loss(model: ObActModel, window: Window) -> Tensor:
    """Return the loss of the recorded actions in the current frames, ``(B,)``."""
    now = model.config.n_obs_steps - 1
    decided_at = torch.full_like(window.begin, now)[:, None]
    forecast = model.encode_history(window.frames, decided_at)[:, 0]
    frames = window.frames
    context, origin = model.condition(forecast, frames.palm[:, now], frames.state[:, now])
    actions = model.normalize(window.actions, origin.detach())
    return model.head.loss(context, actions, window.action_weight)


# -- decisions -------------------------------------------------------------------------------------


def decision_losses(
    model: ObActModel, forecast: Forecast, window: Window, decided_at: Tensor, teacher: Teacher
) -> dict[str, Tensor]:
    """Return the losses of decisions at frames ``decided_at`` ``(B, Q)`` by window, ``(B,)`` each:
    of the forecast, and of the actions of M hands in place of each decision's own.
    """
    targets = window.targets
    delay = window.delay_frames
    assert targets is not None
    last = window.n_frames - 1
    # where the hand is when the decision takes effect, with the fingers that are read now
    palm = gather_frames(window.frames.palm, (decided_at + delay).clamp_max(last))
    state = gather_frames(window.frames.state, decided_at)
    state = torch.cat([palm, state[..., 3:]], dim=-1)
    # at the latest in the last frame but one that is known: a teacher looks a frame ahead
    effect_at = torch.minimum(decided_at + delay, targets.length[:, None] - 2)
    gripped = targets.gripped[:, None, None, None]
    hands = torch.where(gripped, state[:, :, None], teacher.hands(targets, effect_at, state))
    answers = teacher.answer(targets, effect_at, hands, model.config.horizon)
    near = _nearness(answers.frames_left + delay, answers.reachable)
    losses = {"forecast": forecast_loss(model, forecast.places, targets, decided_at, near)}

    n_windows, _, n_states = hands.shape[:3]
    repeated = forecast.later(delay).map(lambda x: repeat(x, "b q ... -> (b q m) ...", m=n_states))
    states = hands.flatten(0, 2)
    context, origin = model.condition(repeated, palm_of(states), states)
    actions = torch.cat([answers.goal, teacher.joints(answers.closing)], dim=-1)
    weight = torch.where(answers.reachable, 1.0, UNREACHABLE_WEIGHT)
    # nothing is decided that would take effect after the catch
    weight = weight * (decided_at + delay < targets.catch[:, None])[..., None]
    weight = repeat(weight, "b q m -> b q m h", h=model.config.horizon)
    # a hand that grips the target goes on as it was recorded
    actions = torch.where(gripped[..., None], window.actions[:, None, None], actions).flatten(0, 2)
    weight = torch.where(gripped, window.action_weight[:, None, None], weight).flatten(0, 2)
    # (B * Q * M,)
    loss = model.head.loss(context, model.normalize(actions, origin.detach()), weight)
    losses["action"] = rearrange(loss, "(b n) -> b n", b=n_windows).mean(1)
    # by the place that was picked
    missed = smooth_norm(palm_of(actions) - origin, 1e-8)
    missed = rearrange((missed * weight).mean(-1), "(b n) -> b n", b=n_windows)
    losses["missed"] = MISSED_WEIGHT * missed.mean(1)
    return losses


def forecast_loss(
    model: ObActModel, places: Tensor, targets: Targets, decided_at: Tensor, near: Tensor
) -> Tensor:
    """Return the loss of forecasts ``(B, Q, K, 3)`` [m] made at frames ``decided_at`` ``(B, Q)``
    by window, ``(B,)``; ``near`` says how much each time counts as one of the intercept, ``(B, Q,
    K)``.
    """
    index = decided_at[..., None] + torch.tensor(FORECAST_FRAMES, device=decided_at.device)
    known = index < targets.length[:, None, None]
    error = smooth_norm(places - targets.places(index), 1e-8) * known
    anywhere = (error / FORECAST_ERROR.at(model.forecaster.ahead_s)).mean((1, 2))
    return anywhere + INTERCEPT_WEIGHT * (error * near).sum(-1).mean(1)


def _nearness(frames: Tensor, reachable: Tensor) -> Tensor:
    """Return the weight of each time of the forecast for intercepts in ``frames`` ``(B, Q, M)``,
    ``(B, Q, K)``.
    """
    times = torch.tensor(FORECAST_FRAMES, device=frames.device)
    left = frames.clamp_max(FORECAST_FRAMES[-1]).float()[..., None]
    weight = (1 - (times - left).abs() / (1 + INTERCEPT_SPREAD * left)).clamp_min(0)
    return (weight / weight.sum(-1, keepdim=True).clamp_min(1e-6) * reachable[..., None]).mean(2)


# -- the closed loop -------------------------------------------------------------------------------


def closed_loop_loss(
    model: ObActModel, forecast: Forecast, window: Window, decided_at: Tensor, teacher: Teacher
) -> Tensor:
    """Return the loss of each window, ``(B,)``, for palms that are rolled out through decisions at
    frames ``decided_at`` ``(B, R)``, in the window or after it; time 0 of the forecast is when they
    take effect.
    """
    targets = window.targets
    delay = window.delay_frames
    assert targets is not None
    after = torch.arange(decided_at.shape[1] + 1, device=decided_at.device)
    effect_at = decided_at[:, :1] + delay + after  # (B, R + 1)
    # a palm passes the target between a frame and the next one, which must be known as well
    known = effect_at[:, :-1] < targets.length[:, None] - 1
    path = gather_frames(targets.path, effect_at.clamp_max(targets.path.shape[1] - 1))
    begin = effect_at[:, :1].clamp_max(window.n_frames - 1)
    palms = palm_of(rolled_out(model, forecast, gather_frames(window.frames.state, begin)))
    misses = teacher.misses(palms - path)  # (B, R')
    known = known[:, : misses.shape[1]] & ~targets.gripped[:, None]
    least = misses.masked_fill(~known, torch.inf).amin(1)
    least = least.where(least.isfinite(), 0.0)
    step = torch.sigmoid((least / teacher.radius_m - RIM) / SOFTNESS)
    distance = (least / DISTANCE_UNIT_M).clamp_max(LARGEST_DISTANCE)
    return (step + DISTANCE_WEIGHT * distance) * known.any(1)
