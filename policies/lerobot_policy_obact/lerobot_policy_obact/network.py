"""The network of ObAct.

encoders     find the target in the newest images (`encoders`)
forecaster   attends to the observation history and forecasts the target (`forecaster`)
condition    picks from the forecast where to meet it
head         samples actions relative to that place (`heads`)

Axes of tensors, in all modules:

B   environments, or windows        T   frames of the history; L those of a window
Q   decisions                       R   decisions of all environments, as rows
M   hands for which one is taken    K   times of the forecast, `FORECAST_FRAMES`
C   cameras                         J   positions read out
H   actions of a chunk              A, S, D, E   entries of an action, state, token, embedding
"""

from __future__ import annotations

from typing import Any, cast

import torch
from einops import einsum, rearrange, repeat
from lerobot.utils.constants import ACTION
from torch import Tensor, nn

from .configuration_obact import HEADS, ObActConfig
from .encoders import ENCODERS, Encoder
from .forecaster import FORECAST_FRAMES, MOST_UNITS, Forecast, Forecaster, GrowingUnit
from .frames import Frames, palm_of, stepped
from .layers import perceptron

Batch = dict[str, Any]

OFFSET = GrowingUnit(0.1, 0.3)
"""Unit of the target's offset from the palm, as the head reads it: about how far a palm is from a
target that it meets. Not tuned."""
N_FEATURES = 64  # numbers of a decision's token that the head reads beside the forecast
LEAST_STD = 1e-3
"""Least standard deviation of an entry of state or action by which it is divided: one that stood
still in the recordings says nothing."""


class ObActModel(nn.Module):
    """The network; ``config`` has its features and its embodiment filled in."""

    action_mean: Tensor
    action_std: Tensor
    state_mean: Tensor
    state_std: Tensor

    def __init__(self, config: ObActConfig) -> None:
        super().__init__()
        assert config.action_feature is not None
        assert config.input_features is not None
        self.config = config
        self.n_relative = config.relative_dims or 0
        n_actions = config.action_feature.shape[0]
        n_state = sum(config.input_features[key].shape[0] for key in config.state_keys)
        encoders = [
            ENCODERS[config.encoder](**config.encoder_options_of(key)) for key in config.cameras
        ]
        self.encoders = nn.ModuleList(encoders).requires_grad_(not config.freeze_encoder)
        self.forecaster = Forecaster(config, sum(encoder.embedding for encoder in encoders))
        self.features = nn.Linear(config.dim, N_FEATURES)
        n_ahead = len(FORECAST_FRAMES)
        n_inputs = n_state
        if config.forecasts:
            n_inputs = 4 * n_ahead + (n_state - self.n_relative if config.grips else 0)
        read = perceptron(n_inputs + N_FEATURES, config.width, config.width)
        self.trunk = nn.Sequential(read, nn.SiLU())
        if config.forecasts:
            # logits over the times of the forecast, and, to grip, for each axis, also over the
            # target's place and that of a palm that moves along
            n_weights = 3 * 2 * n_ahead if config.grips else n_ahead
            self.when = nn.Linear(config.width, config.horizon * n_weights)
        groups = [size for size in (self.n_relative, n_actions - self.n_relative) if size]
        self.head = HEADS[config.head](config.width, config.horizon, groups, **config.head_options)
        for name, size in (("action", n_actions), ("state", n_state)):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_std", torch.ones(size))

    def adopt_stats(self, stats: dict[str, dict[str, Any]]) -> None:
        """Take over LeRobot's statistics of the dataset; actions relative to the palm have mean
        0.
        """

        def moment(name: str, keys: list[str]) -> Tensor:
            found = [torch.as_tensor(stats[key][name]).float().flatten() for key in keys]
            return torch.cat([self.state_mean[:0], *found])  # a robot may have no state

        keys = self.config.state_keys
        self.action_mean.copy_(moment("mean", [ACTION]))
        self.action_std.copy_(moment("std", [ACTION]).clamp_min(LEAST_STD))
        self.state_mean.copy_(moment("mean", keys))
        self.state_std.copy_(moment("std", keys).clamp_min(LEAST_STD))
        self.action_mean[: self.n_relative] = 0.0

    def load_pretrained(self) -> None:
        """Load the published weights that encoders and head name, if any."""
        for part in cast("list[Encoder]", [*self.encoders, self.head]):
            part.load_pretrained()

    def state_of(self, batch: Batch, shape: tuple[int, ...]) -> Tensor:
        """Return the vector observations of a batch of some ``shape``, ``(*shape, S)``, in the type
        of the weights; S is 0 if there are none. LeRobot delivers those of one entry as scalars.
        """
        features = self.config.input_features or {}
        vectors = [
            batch[key].to(self.action_mean).reshape(*shape, *features[key].shape)
            for key in self.config.state_keys
        ]
        return torch.cat([self.action_mean.new_zeros(*shape, 0), *vectors], dim=-1)

    def encode_images(self, images: Batch, before: Batch) -> Tensor:
        """Return what each camera saw, ``(..., C, 5 + E)``, in images ``(..., 3, H, W)``, RGB in
        [0, 1].

        Those of the frame ``before`` only matter to encoders that see motion.
        """
        seen = []
        for encoder, key in zip(self.encoders, self.config.cameras, strict=True):
            image = images[key].to(self.action_mean)
            if self.config.sees_motion:
                image = torch.cat([image, before[key].to(image)], dim=-3)
            seen.append(encoder(image.flatten(0, -4)).unflatten(0, image.shape[:-3]))
        return torch.stack(seen, dim=-2)

    def encode_history(self, frames: Frames, decided_at: Tensor | None = None) -> Forecast:
        """Return the forecast of decisions at frames ``decided_at`` ``(B, Q)``, by default of one
        at the last frame.
        """
        if decided_at is None:
            last = frames.state.shape[1] - 1
            decided_at = torch.full((len(frames.state), 1), last, device=frames.state.device)
        return self.forecaster(frames, decided_at)

    def condition(self, forecast: Forecast, palm: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return what the head reads, ``(R, context)``, and the places that its actions are
        relative to [m], ``(R, H, 3)``.

        Attention over the times of the forecast, whose values are positions, picks where to meet
        the target. To grip it, attention picks along each axis between the forecast and the places
        of a palm that moves along with the target. Without a forecast the actions are relative to
        the palm.

        Args:
            forecast: of R decisions, ``(R, ...)``.
            palm: where the palm will be when a command takes effect [m], ``(R, 3)``.
            state: of the robot, ``(R, S)``. Without a forecast the head reads it, and to grip it
                reads the joints.
        """
        config = self.config
        places = forecast.places
        features = nn.functional.silu(self.features(forecast.features))
        state = (state - self.state_mean) / self.state_std
        if not config.forecasts:
            context = self.trunk(torch.cat([state, features], dim=-1))
            return context, repeat(palm, "r i -> r h i", h=config.horizon)
        unit = OFFSET.at(self.forecaster.ahead_s)
        offset = (places - palm[:, None]) / unit[:, None]  # (R, K, 3)
        distance = offset.norm(dim=-1).clamp_max(MOST_UNITS)
        read = [offset.clamp(-MOST_UNITS, MOST_UNITS).flatten(1), distance, features]
        if config.grips:
            read.append(state[:, self.n_relative :])
        context = self.trunk(torch.cat(read, dim=-1))
        logits = self.when(context)
        if not config.grips:  # one choice of a time for all axes
            weights = rearrange(logits, "r (h k) -> r h k", h=config.horizon).softmax(-1)
            return context, weights @ places
        # for each axis, a choice of a time and of whose place then: the target's, or the palm's
        weights = rearrange(logits, "r (h i k) -> r h i k", h=config.horizon, i=3).softmax(-1)
        along = palm[:, None] + places - places[:, :1]
        both = torch.cat([places, along], dim=1)
        return context, einsum(weights, both, "r h i k, r k i -> r h i")

    def act_once(self, forecast: Forecast, palm: Tensor, state: Tensor) -> Tensor:
        """Return actions ``(R, A)`` sampled in one step from fresh noise, for training; see
        `condition`.
        """
        context, origin = self.condition(forecast, palm, state)
        start = torch.randn(len(context), *self.head.noise_shape, device=context.device)
        return self.unnormalize(self.head.denoise(context, start, 1), origin)[:, 0]

    def normalize(self, actions: Tensor, origin: Tensor) -> Tensor:
        """Map actions ``(R, H, A)`` to what the head predicts, relative to ``origin`` ``(R, H,
        3)``.
        """
        return (actions - self._offset(origin)) / self.action_std

    def unnormalize(self, predicted: Tensor, origin: Tensor) -> Tensor:
        """Invert `normalize`."""
        return predicted * self.action_std + self._offset(origin)

    def _offset(self, origin: Tensor) -> Tensor:
        others = len(self.action_mean) - self.n_relative
        return nn.functional.pad(origin[..., : self.n_relative], (0, others)) + self.action_mean


def rolled_out(
    model: ObActModel,
    forecast: Forecast,
    before: Tensor,
    *,
    begin: Tensor | None = None,
) -> Tensor:
    """Return the states ``(B, W + R, S)`` of hands that follow the head through R decisions: where
    their palms are [m], and, if these must grip, their fingers; the rest stays as it is.

    Args:
        model: whose head it is.
        forecast: of the decisions, ``(B, R)``.
        before: states until the first of these takes effect, ``(B, W, S)``.
        begin: the decision from which on the hand moves, ``(B,)``; by default the first.
    """
    states = [*before.unbind(1)]
    step_m = model.config.embodiment.step_m
    for r in range(forecast.features.shape[1]):
        state = states[-1]
        palm = palm_of(state)
        action = model.act_once(forecast[:, r], palm, state)
        rest = action if model.config.grips else state
        moved = torch.cat([stepped(palm, palm_of(action), step_m), rest[:, 3:]], dim=-1)
        states.append(moved if begin is None else torch.where((begin <= r)[:, None], moved, state))
    return torch.stack(states, dim=1)
