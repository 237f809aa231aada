"""ObAct: encoder -> attention in space -> attention in time -> forecast -> generative action head.

One observation to one action, in the order of this file: `ObActPolicy.select_action` notes a frame and asks for a chunk
when the last one is used up; `ObActModel.sight` encodes the images (`encoders.py`, whose attention over cells finds the
target); `ObActModel.believe` lets a decision attend to the frames before it and forecasts the target (`belief.py`);
`ObActModel.context` picks from that where to meet it; the head samples actions relative to that place (`heads.py`).
`ObActPolicy.forward` is the only loss.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

import torch
from einops import einsum, rearrange, repeat
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.policies.rtc import RTCProcessor
from lerobot.utils.constants import ACTION
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from .belief import FAR, FORECAST_FRAMES, Belief
from .camera import Pinhole
from .configuration_obact import HEADS, ObActConfig
from .decisions import Decisions, Frames, observed
from .encoders import ENCODERS, N_SIGHTING, Encoder
from .heads import Guidance, perceptron

if TYPE_CHECKING:
    from .recordings import Recordings
    from .virtual_episodes import VirtualEpisodes

Batch = dict[str, Any]
N_FEATURES = 64
"""Numbers of the belief that the head reads beside the forecast."""
MISSED_WEIGHT = 10.0
"""Weight in the loss of the distance from the place that attention picks from the forecast to the right one [1/m]."""


class ObActModel(nn.Module):
    """The network.

    Args:
        config: its features filled in, and what comes from the dataset.
    """

    action_mean: Tensor
    action_std: Tensor
    state_mean: Tensor
    state_std: Tensor

    def __init__(self, config: ObActConfig) -> None:
        super().__init__()
        self.config = config
        encoders = [ENCODERS[config.encoder](**config.options_of(key)) for key in config.cameras]
        self.encoders = nn.ModuleList(encoders).requires_grad_(not config.freeze_encoder)
        self.belief = Belief(
            [camera_of(config, key) for key in config.cameras],
            sum(encoder.embedding for encoder in encoders),
            dim=config.dim,
            n_layers=config.n_layers,
            n_heads=config.n_heads,
            n_points=config.n_points,
            fps=config.fps,
        )
        self.features = nn.Linear(config.dim, N_FEATURES)
        n_state, n_actions = config.n_state, config.n_actions
        n_inputs = 4 * len(FORECAST_FRAMES) if config.forecasts else n_state
        if config.grips:
            n_inputs += config.n_joints
        self.trunk = nn.Sequential(perceptron(n_inputs + N_FEATURES, config.width, config.width), nn.SiLU())
        if config.forecasts:
            n_places, n_axes = (2, 3) if config.grips else (1, 1)
            self.when = nn.Linear(config.width, config.horizon * n_axes * n_places * len(FORECAST_FRAMES))
        groups = [size for size in (config.relative_dims, n_actions - config.relative_dims) if size]
        self.head = HEADS[config.head](config.width, config.horizon, groups, **config.head_options)
        self.register_buffer("action_mean", torch.zeros(n_actions))
        self.register_buffer("action_std", torch.ones(n_actions))
        self.register_buffer("state_mean", torch.zeros(n_state))
        self.register_buffer("state_std", torch.ones(n_state))

    def adopt_stats(self, stats: dict[str, dict[str, Any]]) -> None:
        """Take over LeRobot's statistics of the dataset; actions relative to the palm have mean 0."""
        for name, keys in (("action", ["action"]), ("state", self.config.state_keys)):
            for moment in ("mean", "std"):
                values = torch.cat([torch.as_tensor(stats[key][moment], dtype=torch.float32).flatten() for key in keys])
                getattr(self, f"{name}_{moment}").copy_(values if moment == "mean" else values.clamp_min(1e-3))
        self.action_mean[: self.config.relative_dims] = 0.0

    def load_pretrained(self) -> None:
        """Load the published weights that encoders and head name, if any."""
        for part in cast("list[Encoder]", [*self.encoders, self.head]):
            part.load_pretrained()

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return self.action_mean.device

    @property
    def sees_motion(self) -> bool:
        """Whether the encoders take each image together with the one before."""
        return ENCODERS[self.config.encoder].sees_motion

    def sight(self, images: dict[str, Tensor], texts: list[str] | None = None) -> Tensor:
        """Return what each camera saw, ``(F, C, 5 + E)``; images are ``(F, 3 or 6, H, W)`` in [0, 1]."""
        seen = [encoder(images[key], texts) for encoder, key in zip(self.encoders, self.config.cameras, strict=True)]
        return torch.stack(seen, dim=1)

    def believe(self, frames: Frames, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return features ``(B, Q, D)`` and forecasts ``(B, Q, K, 3)`` [m] of decisions at frames ``rows`` ``(B, Q)``.

        A decision sees ``n_obs_frames`` frames before its own, and so do those frames: if there are more, each decision
        is given a window of its own.
        """
        n, q = rows.shape
        reach = self.config.n_obs_frames * self.config.obs_stride
        if self.config.obs_stride > 1 or len(frames.time_s) > reach + 1:
            offsets = torch.tensor(self.config.lookback, device=rows.device)
            frames = frames.windows(rows[..., None] + offsets, offsets / self.config.fps)
            rows = rows.new_full((n * q, 1), len(offsets) - 1)
        palm, extra = frames.palm, frames.sightings[..., N_SIGHTING:].flatten(2)
        features, forecast = self.belief(frames.sightings[..., :N_SIGHTING], palm, extra, frames.time_s, rows)
        return features.reshape(n, q, -1), forecast.reshape(n, q, len(FORECAST_FRAMES), 3)

    def context(self, features: Tensor, forecast: Tensor, palm: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return what the head reads, ``(R, C)``, and the places from which its actions count [m], ``(R, H, 3)``.

        Those are places of the forecast: attention over its times, whose values are positions, picks the one at which
        to meet the target. To grip it, attention picks along each axis between the forecast and the places of a palm
        that moves along with the target. Without a forecast they are where the palm is.

        Args:
            features: of the belief, ``(R, D)``.
            forecast: of the target [m], ``(R, K, 3)``.
            palm: where the palm will be when a command takes effect [m], ``(R, 3)``.
            state: of the robot, ``(R, S)``; the head reads it only if nothing is forecast.
        """
        told = nn.functional.silu(self.features(features))
        state = (state - self.state_mean) / self.state_std
        if not self.config.forecasts:
            context = self.trunk(torch.cat([state, told], dim=-1))
            return context, repeat(palm, "r i -> r h i", h=self.config.horizon)
        unit = 0.1 + 0.3 * self.belief.ahead_s
        offset = (forecast - palm[:, None]) / unit[:, None]  # (R, K, 3)
        distance = offset.norm(dim=-1).clamp_max(FAR)
        joints = state[:, self.config.relative_dims :][:, : self.config.n_joints]
        context = self.trunk(torch.cat([offset.clamp(-FAR, FAR).flatten(1), distance, told, joints], dim=-1))
        if not self.config.grips:
            when = rearrange(self.when(context), "r (h k) -> r h k", h=self.config.horizon).softmax(-1)
            return context, when @ forecast
        along = palm[:, None] + forecast - forecast[:, :1]
        when = rearrange(self.when(context), "r (h i k) -> r h i k", h=self.config.horizon, i=3).softmax(-1)
        return context, einsum(when, torch.cat([forecast, along], dim=1), "r h i k, r k i -> r h i")

    def normalise(self, actions: Tensor, origin: Tensor) -> Tensor:
        """Map actions ``(R, H, A)`` to what the head predicts; they count from ``origin`` ``(R, H, 3)``."""
        return (actions - self._origin(origin)) / self.action_std

    def unnormalise(self, predicted: Tensor, origin: Tensor) -> Tensor:
        """Invert `normalise`."""
        return predicted * self.action_std + self._origin(origin)

    def _origin(self, origin: Tensor) -> Tensor:
        n, size = self.config.relative_dims, len(self.action_mean)
        return torch.nn.functional.pad(origin[..., :n], (0, size - n)) + self.action_mean


def camera_of(config: ObActConfig, key: str) -> Pinhole:
    """Return the calibrated camera of an image key, or one that sees rays of unit depth from the origin."""
    known = config.calibration.get(key)
    if known is None:
        return Pinhole.from_pose([0, 0, 0, 1, 0, 0, 0], 1.0, carried=False)
    return Pinhole.from_pose(known[:7], known[7], carried=bool(known[8]))


class ObActPolicy(PreTrainedPolicy):
    """Observe before act (DynaHOI, Section 4).

    Args:
        config: the policy's config, with its features filled in.
        dataset_stats: LeRobot statistics of the training data; absent when a checkpoint is opened for acting.
        dataset_meta: LeRobot metadata of the training data.
        load_pretrained: whether encoders and head start from published weights, where they name any.
        **kwargs: what else LeRobot may pass, unused.

    Raises:
        ValueError: if the config and the dataset do not fit, naming the option or feature.
    """

    config_class: ClassVar[type[ObActConfig]] = ObActConfig
    name: ClassVar[str] = "obact"
    config: ObActConfig

    def __init__(
        self,
        config: ObActConfig,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        dataset_meta: Any | None = None,
        load_pretrained: bool = True,
        **kwargs: Any,
    ) -> None:
        super().__init__(config)
        config.validate_features()
        self._meta = dataset_meta
        if dataset_meta is not None:
            from .recordings import describe

            describe(dataset_meta, config)
        self.model = ObActModel(config)
        if load_pretrained:
            self.model.load_pretrained()
        if dataset_stats is not None:
            self.model.adopt_stats(dataset_stats)
        decay = config.ema_decay
        self.average = AveragedModel(self.model, multi_avg_fn=_ramped(decay)).requires_grad_(False) if decay else None
        self.recordings: Recordings | None = None
        self.virtual: VirtualEpisodes | None = None
        self.init_rtc_processor()
        self.reset()

    # -- training -------------------------------------------------------------------------------------------------

    def forward(self, batch: Batch, reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a preprocessed batch, and what to log.

        With ``encode_once`` a sample stands for its episode: ``n_decisions`` decisions in it, each from the palm that
        was recorded and, where the target's path is known, from virtual ones. Else it is one decision of a window of
        images.

        Args:
            batch: LeRobot batch with the frames of ``observation_delta_indices`` and the actions of
                ``action_delta_indices``.
            reduction: "mean" for a scalar, "none" for one loss per sample, ``(B,)``.
        """
        model = self.model if self.training else self.acting
        decisions = self._recorded(batch) if self.config.encode_once else self._observed(model, batch)
        n = len(batch["episode_index"] if self.config.encode_once else batch[ACTION])
        losses = {k: rearrange(v, "(b e) -> b e", b=n).mean(1) for k, v in decision_losses(model, decisions).items()}
        config = self.config
        total = config.action_weight * losses["action"] + config.forecast_weight * losses.get("forecast", 0.0)
        logged = {name: value.mean().item() for name, value in losses.items()}
        return (total if reduction == "none" else total.mean()), logged

    def _recorded(self, batch: Batch) -> Decisions:
        """Return decisions in the episodes that the batch names; the first call encodes the dataset."""
        from .recordings import Recordings
        from .virtual_episodes import VirtualEpisodes

        if self.recordings is None:
            self.recordings = Recordings.encoded(self._meta, self.config, self.acting)
            if self.recordings.targets is not None:
                cameras = [camera_of(self.config, key) for key in self.config.cameras]
                step_m = self.config.palm_speed_m_s / self.config.fps
                self.virtual = VirtualEpisodes(
                    self.recordings, self.recordings.targets, cameras, step_m, grips=self.config.grips
                )
        named = batch["episode_index"].flatten().cpu()
        if not self.training:
            return self.recordings.decisions(named, self.config).to(self.model.device)
        self.recordings.named[named] = True  # LeRobot may select episodes and hold others out; batches tell which
        known = self.recordings.known
        others = known[torch.randint(len(known), (len(named), self.config.episodes_per_sample - 1))]
        chosen = torch.cat([named[:, None], others], dim=1).flatten()
        if self.virtual is not None and torch.rand(()) < self.config.virtual_share:
            return self.virtual.decisions(len(chosen), self.config).to(self.model.device)
        return self.recordings.decisions(chosen, self.config).to(self.model.device)

    def _observed(self, model: ObActModel, batch: Batch) -> Decisions:
        """Return one decision of each window of images."""
        config, offsets = self.config, self.config.observation_delta_indices or []
        at = [offsets.index(offset) for offset in config.lookback]
        before = [offsets.index(offset - 1) for offset in config.lookback] if model.sees_motion else None
        images = {
            key: _pairs(batch[key][:, at], None if before is None else batch[key][:, before]) for key in config.cameras
        }
        texts = [text for text in batch.get("task", []) for _ in at]
        flat = model.sight({key: rearrange(x, "b t ... -> (b t) ...") for key, x in images.items()}, texts)
        state = torch.cat([batch[key][:, at] for key in config.state_keys], dim=-1)
        return observed(batch, rearrange(flat, "(b t) ... -> b t ...", t=len(at)), state, config)

    def update(self) -> None:
        """Update the averaged weights; LeRobot calls this after every optimiser step."""
        if self.average is not None:
            self.average.update_parameters(self.model)

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Return parameter groups: weight decay for matrices, none for biases, norms and biases by age."""
        trained = [p for p in self.model.parameters() if p.requires_grad]
        return [
            {"params": [p for p in trained if p.dim() >= 2]},
            {"params": [p for p in trained if p.dim() < 2], "weight_decay": 0.0},
        ]

    # -- acting ---------------------------------------------------------------------------------------------------

    @property
    def acting(self) -> ObActModel:
        """The weights that act: the averaged ones."""
        return self.model if self.average is None else cast("ObActModel", self.average.module)

    def reset(self) -> None:
        """Forget the last episode."""
        reach = self.config.n_obs_frames * self.config.obs_stride + 1
        self._frames: deque[Frames] = deque(maxlen=reach)
        self._images: dict[str, Tensor] = {}
        self._queue: deque[Tensor] = deque()
        self._pending: deque[Tensor] = deque(maxlen=self.config.delay_frames)

    @torch.no_grad()
    def select_action(self, batch: Batch, noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Return the next action of every environment, ``(B, A)``; call it once per control step.

        Args:
            batch: preprocessed observation of one step.
            noise: start of the sampling, ``(B, H, A)``; drawn for every chunk if None.
            **kwargs: unused.
        """
        self.eval()
        self._note(batch, float(self._frames[-1].time_s) + 1 / self.config.fps if self._frames else 0.0)
        if not self._queue:
            self._queue.extend(self._chunk(noise)[:, : self.config.n_action_steps].unbind(1))
        action = self._queue.popleft()
        self._pending.append(self._heeded(batch, action))
        return action

    def _heeded(self, batch: Batch, action: Tensor) -> Tensor:
        """Return where an action sends the palm [m], ``(B, 3)``; not a number where the observation window voids it."""
        goal = torch.nn.functional.pad(action[:, :3], (0, max(0, 3 - action.shape[-1])))
        phase = batch.get("observation.phase")
        return goal if phase is None else torch.where(phase[:, 1:] > 0.5, goal, torch.nan)

    @torch.no_grad()
    def observe(self, batch: Batch) -> None:
        """Add a frame to the history without acting, for callers that ask for chunks now and then."""
        self.eval()
        self._note(batch, self._clock(batch))

    @torch.no_grad()
    def predict_action_chunk(
        self,
        batch: Batch,
        noise: Tensor | None = None,
        inference_delay: int | None = None,
        prev_chunk_left_over: Tensor | None = None,
        execution_horizon: int | None = None,
    ) -> Tensor:
        """Return a whole chunk, ``(B, H, A)``.

        The history counts seconds: a frame is as old as its ``timestamp`` says, or, if the batch has none, as the
        wall clock says. So a server that asks for one chunk after the other sees the past as it was.

        Args:
            batch: preprocessed observation of one step.
            noise: see `select_action`.
            inference_delay: real-time chunking: actions that will have been executed when this chunk is ready.
            prev_chunk_left_over: real-time chunking: the unexecuted ones, ``(B, n, A)`` or ``(n, A)``.
            execution_horizon: real-time chunking: actions over which the guidance to them fades out.
        """
        self.observe(batch)
        guidance = None
        if self.rtc_processor is not None and prev_chunk_left_over is not None:
            left = prev_chunk_left_over.reshape(len(self._frames[-1].state), -1, prev_chunk_left_over.shape[-1])
            guidance = Guidance(self.rtc_processor, left, inference_delay or 0, execution_horizon)
        return self._chunk(noise, guidance)

    def _clock(self, batch: Batch) -> float:
        """Return the time of a frame [s]."""
        return float(batch["timestamp"].flatten()[0]) if "timestamp" in batch else time.monotonic()

    def _note(self, batch: Batch, time_s: float) -> None:
        """Encode the newest frame and keep it.

        Raises:
            ValueError: if the number of environments changed since `reset`.
        """
        model, config = self.acting, self.config
        state = torch.cat([batch[key] for key in config.state_keys], dim=-1)
        if self._frames and len(self._frames[-1].state) != len(state):
            raise ValueError(
                f"the batch changed from {len(self._frames[-1].state)} to {len(state)} environments: call "
                "policy.reset() between rollouts."
            )
        now = {key: batch[key] for key in config.cameras}
        before = (self._images or now) if model.sees_motion else dict.fromkeys(now)
        sightings = model.sight({key: _pairs(now[key], before[key]) for key in now}, batch.get("task"))
        self._images = now
        self._frames.append(Frames(sightings[:, None], state[:, None], state.new_tensor([time_s])))

    def _chunk(self, noise: Tensor | None = None, guidance: Guidance | None = None) -> Tensor:
        """Return the chunk for the newest frame, ``(B, H, A)``."""
        model = self.acting
        sightings, state, time_s = zip(*((f.sightings, f.state, f.time_s) for f in self._frames), strict=True)
        frames = Frames(torch.cat(sightings, dim=1), torch.cat(state, dim=1), torch.cat(time_s))
        newest = len(frames.time_s) - 1
        rows = torch.full((len(frames.state), 1), newest, device=frames.state.device)
        features, forecast = model.believe(frames, rows)
        due = self._due(frames)
        context, origin = model.context(features[:, 0], forecast[:, 0], due, frames.state[:, -1])
        if guidance is not None:
            leftover = guidance.leftover[:, : self.config.horizon]
            guidance = replace(guidance, leftover=model.normalise(leftover, origin[:, : leftover.shape[1]]))
        return model.unnormalise(model.head.sample(context, noise, guidance), origin)

    def _due(self, frames: Frames) -> Tensor:
        """Return where the palm will be when the next command takes effect [m], ``(B, 3)``.

        That follows from the commands on their way, cut to the palm's speed; a caller of `predict_action_chunk` may
        have executed others, so there a palm in motion is taken to go on.
        """
        palm, config = frames.palm[:, -1], self.config
        step_m = config.palm_speed_m_s / config.fps
        for goal in self._pending:
            way = torch.where(goal.isnan(), 0.0, goal - palm)
            palm = palm + way * (step_m / way.norm(dim=-1, keepdim=True).clamp_min(1e-6)).clamp_max(1.0)
        if config.delay_frames and not self._pending and len(frames.time_s) > 1:
            velocity = (palm - frames.palm[:, -2]) / (frames.time_s[-1] - frames.time_s[-2])
            palm = palm + velocity * config.delay_frames / config.fps
        return palm

    # -- real-time chunking, adapters, checkpoints ----------------------------------------------------------------

    def supports_rtc(self) -> bool:
        """Return whether `predict_action_chunk` honours real-time chunking: the head samples."""
        return self.model.head.generative

    def init_rtc_processor(self) -> None:
        """Build the guidance that ``config.rtc_config`` describes; `lerobot-rollout` calls this after setting it."""
        rtc = self.config.rtc_config
        self.rtc_processor = RTCProcessor(rtc) if rtc is not None and rtc.enabled else None

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Open a checkpoint; the weights that its encoders and head started from are not needed any more."""
        return super().from_pretrained(pretrained_name_or_path, load_pretrained=False, **kwargs)

    def wrap_with_peft(self, *args: Any, **kwargs: Any) -> PreTrainedPolicy:
        """Add adapters to the acting weights. Adapters are not averaged, so the average becomes the base."""
        if self.average is not None:
            self.model.load_state_dict(self.average.module.state_dict())
            self.average, self.config.ema_decay = None, 0.0
        return super().wrap_with_peft(*args, **kwargs)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        return {"target_modules": r"model\.belief\.blocks\..*\.(qkv|out)", "modules_to_save": []}


def decision_losses(model: ObActModel, decisions: Decisions) -> dict[str, Tensor]:
    """Return the losses of forecast and action by episode, ``(B,)`` each."""
    features, forecast = model.believe(decisions.frames, decisions.rows)
    losses = {}
    if decisions.future is not None:
        losses["forecast"] = decisions.future.loss(forecast, model.belief.ahead_s)
    m = decisions.palm.shape[2]
    each = [repeat(x, "b q ... -> (b q m) ...", m=m) for x in (features, forecast)]
    palm, state, actions, weight = (
        x.flatten(0, 2) for x in (decisions.palm, decisions.state, decisions.actions, decisions.weight)
    )
    context, origin = model.context(each[0], each[1], palm, state)
    loss = model.head.loss(context, model.normalise(actions, origin.detach()), weight)  # (B * Q * M,)
    if decisions.future is not None:
        missed = ((actions[..., :3] - origin).square().sum(-1) + 1e-8).sqrt()  # by the place that was picked
        loss = loss + MISSED_WEIGHT * (missed * weight).mean(-1)
    return losses | {"action": rearrange(loss, "(b n) -> b n", b=len(features)).mean(1)}


def _pairs(now: Tensor, before: Tensor | None) -> Tensor:
    """Return images together with the ones before, ``(..., 3, H, W) -> (..., 6, H, W)``, if the encoder sees motion."""
    return now if before is None else torch.cat([now, before], dim=-3)


def _ramped(decay: float) -> Any:
    """Return an exponential average whose decay grows with the updates: random first weights are soon forgotten."""

    def average(averaged: Any, current: Any, n_averaged: Any) -> None:
        n = int(n_averaged)
        get_ema_multi_avg_fn(min(decay, (1 + n) / (10 + n)))(averaged, current, n_averaged)

    return average
