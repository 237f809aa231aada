"""ObAct as a LeRobot policy: training loss, acting, checkpoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import torch
from huggingface_hub import ModelCard
from lerobot.configs import NormalizationMode
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.policies.rtc import RTCProcessor
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from .action_frame import ActionFrame, affine_of, looks_absolute
from .augment import jitter_colors, shift_images
from .configuration_obact import ObActConfig
from .decisions import Decisions
from .finite import require_finite
from .frames import EncodedFrames
from .heads.base import Guide
from .history import ChunkQueue, History
from .model import ObActModel
from .model_card import describe
from .observation import Observation
from .privileged import FrameColumn
from .rtc import rtc_guide


class ObActPolicy(PreTrainedPolicy):
    """Observe before act (DynaHOI, Section 4): a window of frames conditions a chunk of actions.

    Args:
        config: The policy's config, with its features filled in.
        dataset_stats: LeRobot statistics of the training data; absent when a checkpoint is opened for acting.
        dataset_meta: LeRobot metadata of the training data, for its frame rate.
        load_pretrained: Whether backbone and head start from published weights, where they name any.
        **kwargs: What else LeRobot may pass, unused.
    """

    config_class = ObActConfig
    name = "obact"

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
        if dataset_meta is not None:
            config.fps = float(dataset_meta.fps)
        if config.action_frame == "auto":
            config.action_frame = _choose_action_frame(config, dataset_stats)
        self.frame = ActionFrame(config.relative_dims if config.action_frame == "relative" else 0)
        self.labels = _labels(config, dataset_meta)
        self._set_stats(dataset_stats)
        self.model = ObActModel(config)
        if load_pretrained:
            self.model.backbone.load_pretrained()
            self.model.head.load_pretrained()
        self.ema = _averaged(self.model, config.ema_decay) if config.ema_decay else None
        self.register_load_state_dict_pre_hook(_match_averages)
        self.history, self.queue = History(config.windows), ChunkQueue()
        self.init_rtc_processor()
        if config.compile_model:
            self._compile()

    # -- training -------------------------------------------------------------------------------------------

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a preprocessed batch.

        Args:
            batch: LeRobot batch with the frames of ``observation_delta_indices`` and the actions of
                ``action_delta_indices``.
            reduction: "mean" for a scalar, "none" for one loss per sample, shape ``(B,)``.

        Returns:
            Loss, and what to log.
        """
        observation = Observation.from_batch(batch, self.config)
        if self.training:
            observation = self._augmented(observation)
        frames = self._acting_model.encode(observation)
        chunk_index = torch.tensor(self.config.windows.action_index, device=batch[ACTION].device)  # (K, H)
        keep = _kept_actions(batch)[:, chunk_index] & self._executed(batch)  # (B, L) -> (B, K, H)
        # Where no chunk has an action to keep all are computed, masked: every weight needs a gradient, if only a zero.
        decisions = self._decisions(frames, self.config.windows.frame_index, wanted=keep.any(-1) | ~keep.any())

        actions, kept = decisions.pick(batch[ACTION][:, chunk_index]), decisions.pick(keep)  # (R, H, A), (R, H)
        error = self._chunk_error(actions, kept, frames, decisions) * kept  # (R, H)
        seen = self._privileged_error(batch, frames)  # (B, T)
        privileged = self.config.privileged_weight * _masked_mean(seen, frames.keep)  # (B,)
        require_finite({"action": error, "privileged": privileged}, batch)
        if reduction == "none":
            loss = _masked_mean(decisions.spread(error).flatten(1), keep.flatten(1)) + privileged
            return loss, {"loss": loss.mean().item()}
        return error.sum() / keep.sum().clamp_min(1) + privileged.mean(), {}

    def _chunk_error(self, actions: Tensor, keep: Tensor, frames: EncodedFrames, decisions: Decisions) -> Tensor:
        """Return the head's loss of every action of the wanted chunks, ``(R, H)``, given ``actions (R, H, A)``."""
        position = decisions.current(frames.position)  # (R, P)
        if self.training:
            self.frame.observe(actions, position, keep)
        condition = self._acting_model.conditions(frames, decisions)
        losses = self._acting_model.head.loss(self.frame.to_model(actions, position), condition)  # (R, H, A)
        return (losses * self._dimension_weights(losses)).mean(-1)

    def _dimension_weights(self, losses: Tensor) -> Tensor:
        """Return the weight of each action dimension, ``(A,)`` with mean 1."""
        weights = losses.new_ones(losses.shape[-1])
        weights[: self.frame.n_dims] = self.config.relative_weight
        return weights / weights.mean()

    def _executed(self, batch: dict[str, Tensor]) -> Tensor:
        """Tell which decisions are ever executed, broadcast to ``(B, K, H)``: those after the rise of ``replan_key``.

        A normalised indicator is negative before its rise, and zero where it never changes.
        """
        value, windows = batch.get(self.config.replan_key), self.config.windows
        if value is None:
            return torch.ones(1, 1, 1, dtype=torch.bool, device=batch[ACTION].device)
        value = value.reshape(len(value), len(windows.observation_offsets), -1)  # (B, T, D), or (B, T) of numbers
        moments = [index[-1] for index in windows.frame_index]
        return value[:, moments, -1:] >= 0  # (B, K, 1)

    def _privileged_error(self, batch: dict[str, Tensor], frames: EncodedFrames) -> Tensor:
        """Return how far off the probe is in every frame, in units of the normalised state, ``(B, T)``."""
        if self.labels is None:
            return torch.zeros_like(frames.keep, dtype=frames.tokens.dtype)
        place = self.labels(batch["index"], self.config.windows.observation_offsets)  # (B, T, P)
        offset = self.frame.normalise_state(place) - frames.position[..., : place.shape[-1]]
        return (self._acting_model.probe(frames.tokens) - offset).abs().mean(-1)

    def _augmented(self, observation: Observation) -> Observation:
        shape = observation.images.shape
        images = observation.images.flatten(1, 2)  # (B, T, C, 3, H, W) -> (B, T*C, 3, H, W): one draw per sample
        images = jitter_colors(shift_images(images, self.config.random_shift_px), self.config.color_jitter)
        return replace(observation, images=images.reshape(shape))

    def update(self) -> None:
        """Move the averaged weights; LeRobot calls this after every optimiser step."""
        if self.ema is not None:
            self.ema.update_parameters(self.model)

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Return parameter groups: weight decay for matrices, none for biases, norms and gates.

        One kernel steps a whole group; of many small weights, one by one, that takes a quarter of the time.
        """
        trained = [p for p in self.model.parameters() if p.requires_grad]
        return [
            {"params": [p for p in trained if p.dim() >= 2], "fused": True},
            {"params": [p for p in trained if p.dim() < 2], "fused": True, "weight_decay": 0.0},
        ]

    # -- acting ---------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget the last episode."""
        self.history.clear()
        self.queue.clear()

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Return the next action of every environment, shape ``(B, A)``, normalised.

        Call it once per control step: each call is one frame of history. A row plans when its chunk is used
        up, and when its ``replan_key`` rises, because a chunk planned while only watching is stale once the
        hand may move.

        Args:
            batch: Preprocessed observation of one step.
            noise: Where the chunks of this step start, shape ``(B, H, A)``; drawn as ``noise_seed`` says when
                absent.
            **kwargs: Unused.
        """
        self.eval()
        frame = Observation.from_batch(batch, self.config)
        self.history.append(frame)
        rows = self.queue.rows_to_plan(self._trigger(batch), n_rows=len(frame.keep))
        if rows:
            start = self._noise([self.queue.n_planned[row] for row in rows]) if noise is None else noise[rows]
            chunks = self._plan(self.history.window(self._acting_model.encode).rows(rows), start)
            self.queue.put(rows, chunks[:, self.config.latency_frames :][:, : self.config.n_action_steps])
        return self.queue.pop()

    @torch.no_grad()
    def predict_action_chunk(
        self,
        batch: dict[str, Tensor],
        noise: Tensor | None = None,
        inference_delay: int | None = None,
        prev_chunk_left_over: Tensor | None = None,
        execution_horizon: int | None = None,
    ) -> Tensor:
        """Return a whole chunk, shape ``(B, H, A)``, normalised.

        Args:
            batch: One frame per environment, which joins the history, or a dataset batch with a time axis.
            noise: Where sampling starts, shape ``(B, H, A)``; drawn as ``noise_seed`` says when absent.
            inference_delay: Real-time chunking: actions that will have run when this chunk is ready.
            prev_chunk_left_over: Real-time chunking: unexecuted normalised actions, shape ``(B, n, A)`` or
                ``(n, A)``.
            execution_horizon: Real-time chunking: actions over which the old chunk fades out.
        """
        self.eval()
        window = self._window(Observation.from_batch(batch, self.config))
        start = self._noise([0] * len(window.keep)) if noise is None else noise
        guide = None
        if self.rtc_processor is not None and prev_chunk_left_over is not None:
            leftover = prev_chunk_left_over.reshape(len(window.keep), -1, start.shape[-1])[:, : self.config.horizon]
            leftover = self.frame.to_model(leftover, window.position[:, -1])
            guide = rtc_guide(self.rtc_processor, leftover, inference_delay or 0, execution_horizon)
        return self._plan(window, start, guide)

    def _plan(self, window: EncodedFrames, noise: Tensor, guide: Guide | None = None) -> Tensor:
        whole = [list(range(window.keep.shape[1]))]
        condition = self._acting_model.conditions(window, self._decisions(window, whole))
        chunk = self._acting_model.head.sample(condition, noise, guide)  # (B, H, A)
        return self.frame.to_actions(chunk, window.position[:, -1])

    def _window(self, observation: Observation) -> EncodedFrames:
        n_frames, windows = observation.keep.shape[1], self.config.windows
        if n_frames == len(windows.lookback):
            return self._acting_model.encode(observation)
        if n_frames == len(windows.observation_offsets):
            return self._acting_model.encode(observation.frames(windows.frame_index[0]))
        if n_frames == 1:
            self.history.append(observation)
            return self.history.window(self._acting_model.encode)
        raise ValueError(
            f"the batch has {n_frames} frames per sample, but must have 1 or "
            f"{len(windows.observation_offsets)}: those at {windows.observation_offsets}."
        )

    def _noise(self, chunk_numbers: list[int]) -> Tensor:
        """Draw the start of one chunk per row; with a seed it depends on the chunk's number in its episode alone."""
        shape = (self.config.horizon, self.model.head.noise_dim)
        device = next(self.model.parameters()).device
        if self.config.noise_seed is None:
            return torch.randn(len(chunk_numbers), *shape, device=device) * self.config.noise_scale
        seeds = [self.config.noise_seed + 1_000_003 * number for number in chunk_numbers]
        draws = [torch.randn(shape, generator=torch.Generator().manual_seed(seed)) for seed in seeds]
        return torch.stack(draws).to(device) * self.config.noise_scale

    def _trigger(self, batch: dict[str, Tensor]) -> Tensor | None:
        value = batch.get(self.config.replan_key)
        return None if value is None else value.flatten(1)[:, -1]  # (B, 1) -> (B,)

    def _decisions(
        self, frames: EncodedFrames, frame_index: list[list[int]], wanted: Tensor | None = None
    ) -> Decisions:
        age_s = -torch.tensor(self.config.windows.lookback, device=frames.keep.device) / self.config.fps  # (s + 1,)
        return Decisions.among(frames.keep, frame_index, age_s, wanted)

    @property
    def _acting_model(self) -> ObActModel:
        return self.model if self.training or self.ema is None else self.ema.module

    # -- what LeRobot asks for
    # -----------------------------------------------------------------------------------------

    def supports_rtc(self) -> bool:
        """Whether `predict_action_chunk` honours real-time chunking: the head must be a flow."""
        return self.model.head.accepts_guide

    def init_rtc_processor(self) -> None:
        """Build the guidance that ``config.rtc_config`` describes; LeRobot's rollout calls this after setting
        it.
        """
        rtc = self.config.rtc_config
        self.rtc_processor = RTCProcessor(rtc) if rtc is not None and rtc.enabled else None

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Open a checkpoint. With ``dataset_stats`` (fine-tuning) actions are relative in the new data's
        units.
        """
        policy = super().from_pretrained(pretrained_name_or_path, load_pretrained=False, **kwargs)
        policy._set_stats(kwargs.get("dataset_stats"))
        return policy

    def wrap_with_peft(self, *args: Any, **kwargs: Any) -> PreTrainedPolicy:
        """Add adapters to the acting weights. Adapters are not averaged, so the average becomes the base."""
        if self.ema is not None:
            self.model.load_state_dict(self.ema.module.state_dict())
            self.ema, self.config.ema_decay = None, 0.0
        return super().wrap_with_peft(*args, **kwargs)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        return {"target_modules": r"model\..*\.(q_proj|v_proj)", "modules_to_save": []}

    def generate_model_card(self, *args: Any, **kwargs: Any) -> ModelCard:
        """Return LeRobot's model card with a section on what this policy is and how it was configured."""
        card = super().generate_model_card(*args, **kwargs)
        card.text += describe(self.config, n_parameters=sum(p.numel() for p in self.model.parameters()))
        return card

    def _set_stats(self, stats: dict[str, dict[str, Any]] | None) -> None:
        if stats is None:
            return
        for name, key in (("action", ACTION), ("state", OBS_STATE)):
            mode = self.config.normalization_mapping.get(name.upper(), NormalizationMode.IDENTITY)
            self.frame.set_stats(name, affine_of(stats.get(key), mode))

    def _compile(self) -> None:
        for model in (self.model, *([self.ema.module] if self.ema is not None else [])):
            for part in (model.backbone, model.attention, *model.head.children()):
                part.compile(backend=self.config.compile_backend)


def _choose_action_frame(config: ObActConfig, stats: dict[str, dict[str, Any]] | None) -> str:
    """Resolve "auto": relative where state and action are measured to be the same quantity."""
    if not config.can_be_relative or not stats or ACTION not in stats or OBS_STATE not in stats:
        return "absolute"
    return "relative" if looks_absolute(stats[ACTION], stats[OBS_STATE], config.relative_dims) else "absolute"


def _labels(config: ObActConfig, meta: Any | None) -> FrameColumn | None:
    """Open the privileged column while training, where the config names one."""
    if not config.privileged_key or meta is None:
        return None
    if config.action_frame != "relative":
        raise ValueError(
            f"privileged_key is {config.privileged_key!r}, but only action_frame='relative' knows the coordinates of "
            f"'observation.state'; action_frame is {config.action_frame!r}, so privileged_key must be ''."
        )
    return FrameColumn(meta, config.privileged_key, config.relative_dims)


def _kept_actions(batch: dict[str, Tensor]) -> Tensor:
    pad = batch.get(f"{ACTION}_is_pad")
    return torch.ones_like(batch[ACTION][..., 0], dtype=torch.bool) if pad is None else ~pad.bool()  # (B, L)


def _masked_mean(error: Tensor, keep: Tensor) -> Tensor:
    """Average ``(B, n)`` over what is kept of each sample, shape ``(B,)``."""
    return (error * keep).sum(-1) / keep.sum(-1).clamp_min(1)


def _averaged(model: nn.Module, decay: float) -> AveragedModel:
    """Return an exponential average whose decay grows from 0, so that it forgets the random start quickly."""

    def average(averaged: list[Tensor], current: list[Tensor], n_averaged: Tensor) -> None:
        n = int(n_averaged)
        torch._foreach_lerp_(averaged, current, 1 - min(decay, (1 + n) / (10 + n)))

    return AveragedModel(model, multi_avg_fn=average).requires_grad_(False)


def _match_averages(policy: ObActPolicy, state: dict[str, Tensor], prefix: str, *_: Any) -> None:
    """Fit a checkpoint with or without averaged weights to a policy without or with them.

    A policy without an average takes the checkpoint's average as its weights; one with an average starts it
    from the checkpoint's weights.
    """
    plain, averaged = f"{prefix}model.", f"{prefix}ema.module."
    found = {key: value for key, value in state.items() if key.startswith(averaged)}
    if policy.ema is None:
        for key in [key for key in state if key.startswith(f"{prefix}ema.")]:
            del state[key]
        state.update({plain + key.removeprefix(averaged): value for key, value in found.items()})
    elif not found:
        weights = {key: value for key, value in state.items() if key.startswith(plain)}
        state.update({averaged + key.removeprefix(plain): value for key, value in weights.items()})
        state[f"{prefix}ema.n_averaged"] = policy.ema.n_averaged
