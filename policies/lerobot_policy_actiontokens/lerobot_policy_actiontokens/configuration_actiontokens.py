"""The config of ``--policy.type=actiontokens``."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig

from . import openvla  # noqa: F401, so that transformers opens its checkpoints


@PreTrainedConfig.register_subclass("actiontokens")
@dataclass
class ActionTokensConfig(PreTrainedConfig):
    """A vision-language model that writes actions.

    Attributes:
        vlm_name: folder or Hub name of any image-text model of `transformers`, with its processor, or of OpenVLA.
        load_vlm_weights: Start from its published weights; a checkpoint brings its own.
        unnorm_key: Dataset among an OpenVLA checkpoint's ``norm_stats`` by whose percentiles actions are normalised;
            none for those of the data that is trained on.
        freeze_vision: Leave the vision tower as it is.
        chunk_size: Actions written at a time.
        n_action_steps: How many of them are executed.
        dtype: Of the weights, "float32" or "bfloat16".
    """

    vlm_name: str = "HuggingFaceTB/SmolVLM2-500M-Video-Instruct"
    load_vlm_weights: bool = True
    unnorm_key: str | None = None
    freeze_vision: bool = True
    chunk_size: int = 1
    n_action_steps: int = 1
    dtype: str = "float32"
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "VISUAL": NormalizationMode.IDENTITY,
            "STATE": NormalizationMode.QUANTILES,
            "ACTION": NormalizationMode.QUANTILES,
        }
    )
    optimizer_lr: float = 2e-5
    optimizer_weight_decay: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise ValueError(
                f"n_action_steps is {self.n_action_steps}, but must be 1 to {self.chunk_size} (chunk_size)."
            )
        if self.dtype not in ("float32", "bfloat16"):
            raise ValueError(f"dtype is {self.dtype!r}, but must be float32 or bfloat16.")

    @property
    def observation_delta_indices(self) -> None:
        """The current frame alone."""
        return

    @property
    def action_delta_indices(self) -> list[int]:
        """The actions of a chunk."""
        return list(range(self.chunk_size))

    @property
    def reward_delta_indices(self) -> None:
        """Imitation needs no reward."""
        return

    def validate_features(self) -> None:
        """Check that there is an image and a flat action.

        Raises:
            ValueError: If not.
        """
        if not self.image_features:
            raise ValueError(f"actiontokens needs an image, but the inputs are {sorted(self.input_features or {})}.")
        if self.action_feature is None or len(self.action_feature.shape) != 1:
            raise ValueError(f"'action' must be a flat vector, but the outputs are {self.output_features}.")

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return AdamW."""
        return AdamWConfig(lr=self.optimizer_lr, weight_decay=self.optimizer_weight_decay)

    def get_scheduler_preset(self) -> None:
        """Keep the learning rate, as OpenVLA does."""
        return
