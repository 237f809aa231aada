"""ObAct as a LeRobot policy: what `lerobot-train`, `lerobot-eval` and `lerobot-rollout` call."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, ClassVar, Self, cast

import torch
from huggingface_hub import ModelCard
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.policies.rtc import RTCProcessor
from torch import Tensor

from .action_frame import ActionFrame, resolve_action_frame
from .augment import augmented
from .averaging import averaged_copy, match_averages
from .configuration_obact import ObActConfig
from .demonstrated import demonstrated
from .frames import EncodedFrames
from .heads.base import Guide
from .model import ObActModel
from .model_card import describe, insert_section
from .objective import ImitationObjective
from .observation import Batch, Observation
from .planner import ChunkPlanner
from .privileged import privileged_labels
from .rtc import rtc_guide


class ObActPolicy(PreTrainedPolicy):
    """Observe before act (DynaHOI, Section 4): a window of frames conditions a chunk of actions.

    Args:
        config: the policy's config, with its features filled in.
        dataset_stats: LeRobot statistics of the training data; absent when a checkpoint is opened for acting.
        dataset_meta: LeRobot metadata of the training data, for its frame rate and privileged column.
        load_pretrained: whether backbone and head start from published weights, where they name any.
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
        if dataset_meta is not None:
            config.fps = float(dataset_meta.fps)
        config.action_frame = resolve_action_frame(config, dataset_stats)
        self.frame = ActionFrame(config.relative_dims if config.action_frame == "relative" else 0)
        self.model = ObActModel(config)
        if load_pretrained:
            self.model.load_pretrained()
        self.ema = averaged_copy(self.model, config.ema_decay) if config.ema_decay else None
        self.register_load_state_dict_pre_hook(match_averages)
        labels = privileged_labels(config, dataset_meta)
        forecasts = demonstrated(self.model.head, config, dataset_meta)
        self.objective = ImitationObjective(config, self.frame, labels, forecasts)
        self.planner = ChunkPlanner(config, self.frame)
        self.set_dataset_stats(dataset_stats)
        self.init_rtc_processor()
        if config.compile_model:
            self._compile()

    # -- training -------------------------------------------------------------------------------------------------

    def forward(self, batch: Batch, reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a preprocessed batch.

        Args:
            batch: LeRobot batch with the frames of ``observation_delta_indices`` and the actions of
                ``action_delta_indices``.
            reduction: "mean" for a scalar, "none" for one loss per sample, shape ``(B,)``.

        Returns:
            Loss, and what to log.

        Raises:
            FloatingPointError: if the loss is not finite.
        """
        observation = Observation.from_batch(batch, self.config)
        if self.training:
            observation = augmented(observation, self.config)
        loss = self.objective(self._active_model, batch, observation, self.training)
        if reduction == "none":
            per_sample = loss.per_sample()
            return per_sample, {"loss": per_sample.mean().item()}
        return loss.mean(), {}

    def update(self) -> None:
        """Update the averaged weights; LeRobot calls this after every optimiser step."""
        if self.ema is not None:
            self.ema.update_parameters(self.model)

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Return parameter groups: weight decay for matrices, none for biases, norms and gates.

        The fused AdamW steps a whole group in one kernel: many small weights one by one take four times as long.
        """
        trained = [p for p in self.model.parameters() if p.requires_grad]
        return [
            {"params": [p for p in trained if p.dim() >= 2], "fused": True},
            {"params": [p for p in trained if p.dim() < 2], "fused": True, "weight_decay": 0.0},
        ]

    # -- acting ---------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget the last episode."""
        self.planner.reset()

    @torch.no_grad()
    def select_action(self, batch: Batch, noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Return the next action of every environment, normalised, shape ``(B, A)``.

        Call it once per control step: each call adds one frame to the history. An environment replans when its chunk
        is used up, and when its ``replan_key`` rises: a chunk predicted during the observation window is outdated once
        the hand may move.

        Args:
            batch: preprocessed observation of one step.
            noise: start of the chunks predicted in this step, shape ``(B, H, noise_dim)``; None draws it as
                ``noise_seed`` says.
            **kwargs: unused.
        """
        self.eval()
        return self.planner.next_action(self._active_model, batch, noise)

    def select_action_after(self, frame: Observation, looks: Tensor, batch: Batch) -> Tensor:
        """Return the next action as `select_action` does, of a frame whose images have been looked at.

        Args:
            frame: the observation of one control step.
            looks: what the model's `look` returned for it.
            batch: what it was read from.
        """
        model = self._active_model
        return self.planner.advance(model, self.encode_looks(frame, looks), batch)

    def encode_looks(self, frame: Observation, looks: Tensor) -> EncodedFrames:
        """Encode a frame whose images have been looked at, see `ObActModel.encode_looks`."""
        return self._active_model.encode_looks(frame, looks)

    def plan_after(self, rows: list[int], leftover: Tensor | None, length: Tensor) -> Tensor:
        """Return normalised chunks ``(R, D + H, A)`` of some environments, from the frames that were noted.

        Args:
            rows: which environments.
            leftover, length: what each executes meanwhile, see `ChunkPlanner.prefix`; D is the greatest length.
        """
        model = self._active_model
        window = self.planner.history.window(model.encode).rows(rows)
        prefix = self.planner.prefix(window, leftover, length)
        return self.planner.plan(model, window, self.planner.noise(model, [0] * len(rows)), prefix=prefix)

    @torch.no_grad()
    def observe(self, batch: Batch) -> None:
        """Add one frame per environment to the history without acting, for callers that ask for chunks now and then."""
        self.planner.note(batch)

    @torch.no_grad()
    def predict_action_chunk(
        self,
        batch: Batch,
        noise: Tensor | None = None,
        inference_delay: int | None = None,
        prev_chunk_left_over: Tensor | None = None,
        execution_horizon: int | None = None,
    ) -> Tensor:
        """Return a whole chunk, normalised, shape ``(B, H, A)``.

        A head with ``accepts_prefix`` plans from where the hand will be after the actions that are executed meanwhile,
        and puts those first: ``(B, D + H, A)``.

        Args:
            batch: one frame per environment, which joins the history, or a dataset batch with a time axis.
            noise: start of the sampling, shape ``(B, H, noise_dim)``; None draws it as ``noise_seed`` says.
            inference_delay: real-time chunking: actions that will have been executed when this chunk is ready.
            prev_chunk_left_over: real-time chunking: unexecuted normalised actions, shape ``(B, n, A)`` or ``(n, A)``.
            execution_horizon: real-time chunking: actions over which the guidance to the old chunk fades out.

        Raises:
            ValueError: if the batch has the wrong number of frames.
        """
        self.eval()
        model = self._active_model
        window = self.planner.window(model, batch)
        start = self.planner.noise(model, [0] * len(window.keep)) if noise is None else noise
        if self.accepts_prefix and inference_delay is not None:
            length = torch.full((len(window.keep),), inference_delay, device=window.position.device)
            leftover = prev_chunk_left_over
            leftover = None if leftover is None else leftover.reshape(len(length), -1, leftover.shape[-1])
            return self.planner.plan(model, window, start, prefix=self.planner.prefix(window, leftover, length))
        guide = self._guide(window, prev_chunk_left_over, inference_delay or 0, execution_horizon)
        return self.planner.plan(model, window, start, guide)

    @property
    def accepts_prefix(self) -> bool:
        """Whether a chunk continues the actions that are executed while it is planned, without any guidance."""
        return self._active_model.head.accepts_prefix

    def _guide(
        self, window: EncodedFrames, leftover: Tensor | None, inference_delay: int, execution_horizon: int | None
    ) -> Guide | None:
        """Return the guidance of real-time chunking towards the unexecuted actions, if there are any."""
        if self.rtc_processor is None or leftover is None:
            return None
        leftover = leftover.reshape(len(window.keep), -1, leftover.shape[-1])[:, : self.config.horizon]
        leftover = self.frame.to_model(leftover, window.position[:, -1])  # (B, n, A)
        return rtc_guide(self.rtc_processor, leftover, inference_delay, execution_horizon)

    def supports_rtc(self) -> bool:
        """Return whether `predict_action_chunk` honours real-time chunking: the head is a flow, or takes a prefix."""
        return self.model.head.accepts_guide or self.model.head.accepts_prefix

    def init_rtc_processor(self) -> None:
        """Build the guidance that ``config.rtc_config`` describes; `lerobot-rollout` calls this after setting it."""
        rtc = self.config.rtc_config
        self.rtc_processor = RTCProcessor(rtc) if rtc is not None and rtc.enabled else None

    # -- checkpoints and adapters ---------------------------------------------------------------------------------

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Open a checkpoint; ``dataset_stats`` (fine-tuning) replace the units and normalisation stored in it."""
        policy = super().from_pretrained(pretrained_name_or_path, load_pretrained=False, **kwargs)
        policy.set_dataset_stats(kwargs.get("dataset_stats"))
        return policy

    def for_acting(self) -> Self:
        """Return a copy without the average, whose weights are the average: half the size, the same actions."""
        config = copy.deepcopy(self.config)
        config.ema_decay, config.pretrained_path = 0.0, None
        acting = type(self)(config, load_pretrained=False)
        acting.load_state_dict(self.state_dict())
        return acting

    def set_dataset_stats(self, stats: dict[str, dict[str, Any]] | None) -> None:
        """Adopt the LeRobot statistics ``{key: {"mean": (D,), ...}}`` that batches are normalised with, if given."""
        if stats is not None:
            self.frame.set_dataset_stats(stats, self.config.normalization_mapping)
            self.objective.set_dataset_stats(stats)

    def wrap_with_peft(self, *args: Any, **kwargs: Any) -> PreTrainedPolicy:
        """Add adapters to the acting weights. Adapters are not averaged, so the average becomes the base."""
        if self.ema is not None:
            self.model.load_state_dict(self.ema.module.state_dict())
            self.ema, self.config.ema_decay = None, 0.0
        return super().wrap_with_peft(*args, **kwargs)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        return {"target_modules": r"model\..*\.(q_proj|v_proj)", "modules_to_save": []}

    def generate_model_card(self, dataset_repo_id: str, *args: Any, **kwargs: Any) -> ModelCard:
        """Return LeRobot's model card, with a section on this policy instead of the instructions for robots."""
        card = super().generate_model_card(dataset_repo_id, *args, **kwargs)
        n_parameters = sum(p.numel() for p in self.model.parameters())
        card.text = insert_section(card.text, describe(self.config, n_parameters, dataset_repo_id))
        return card

    # -- weights --------------------------------------------------------------------------------------------------

    @property
    def _active_model(self) -> ObActModel:
        """The trained weights in training mode, the averaged ones otherwise."""
        return self.model if self.training else self._evaluated_model

    @property
    def _evaluated_model(self) -> ObActModel:
        return self.model if self.ema is None else cast(ObActModel, self.ema.module)

    def _compile(self) -> None:
        for model in {self.model, self._evaluated_model}:
            model.compile_parts(self.config.compile_backend)
