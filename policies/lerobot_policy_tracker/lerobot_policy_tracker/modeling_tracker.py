"""The tracker as a LeRobot policy: what `lerobot-train`, `lerobot-eval` and `lerobot-rollout` call."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, ClassVar, Self, cast

from huggingface_hub import ModelCard
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from .acting import ChunkActing
from .action_frame import ActionFrame, resolve_action_frame
from .augment import augmented
from .averaging import averaged_copy, match_averages
from .configuration_tracker import TrackerConfig
from .demonstrated import demonstrated
from .model import TrackerModel
from .model_card import describe, insert_section
from .objective import ImitationObjective
from .observation import Batch, Observation
from .planner import ChunkPlanner
from .privileged import privileged_labels


class TrackerPolicy(ChunkActing, PreTrainedPolicy):
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

    config_class: ClassVar[type[TrackerConfig]] = TrackerConfig
    name: ClassVar[str] = "tracker"
    config: TrackerConfig

    def __init__(
        self,
        config: TrackerConfig,
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
        self.model = TrackerModel(config)
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
    def _active_model(self) -> TrackerModel:
        """The trained weights in training mode, the averaged ones otherwise."""
        return self.model if self.training else self._evaluated_model

    @property
    def _evaluated_model(self) -> TrackerModel:
        return self.model if self.ema is None else cast(TrackerModel, self.ema.module)

    def _compile(self) -> None:
        for model in {self.model, self._evaluated_model}:
            model.compile_parts(self.config.compile_backend)
