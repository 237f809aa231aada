"""The config of ``--policy.type=upvla``."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig, CosineDecayWithWarmupSchedulerConfig


@PreTrainedConfig.register_subclass("upvla")
@dataclass
class UPVLAConfig(PreTrainedConfig):
    """A language model that reads an image as codes, and predicts its future and the actions together.

    Attributes:
        llm_name: Folder or Hub name of any causal language model of `transformers`, with its tokenizer.
        image_tokenizer: Folder or Hub name of a `diffusers` ``VQModel``, which turns images into codes.
        image_tokenizer_folder: Where in there it is.
        load_weights: Start from their published weights; a checkpoint brings its own.
        image_size: Side of the square image that is turned into codes [px].
        chunk_size: Actions predicted at a time; the image is predicted as many frames ahead.
        n_action_steps: How many of them are executed.
        prediction_weight: Weight of the image's cross-entropy in the loss.
        action_weight: Weight of the actions' squared error.
        n_heads: Attention heads of the pooling before the action head.
        dtype: Of the weights, "float32" or "bfloat16".
    """

    llm_name: str = "microsoft/phi-1_5"
    image_tokenizer: str = "amused/amused-256"
    image_tokenizer_folder: str = "vqvae"
    load_weights: bool = True
    image_size: int = 256
    chunk_size: int = 10
    n_action_steps: int = 10
    prediction_weight: float = 1.0
    action_weight: float = 1.0
    n_heads: int = 8
    dtype: str = "float32"
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "VISUAL": NormalizationMode.IDENTITY,
            "STATE": NormalizationMode.QUANTILES,
            "ACTION": NormalizationMode.QUANTILES,
        }
    )
    optimizer_lr: float = 1e-4
    optimizer_weight_decay: float = 0.01
    scheduler_warmup_steps: int = 1000
    scheduler_decay_steps: int = 200_000

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise ValueError(
                f"n_action_steps is {self.n_action_steps}, but must be 1 to {self.chunk_size} (chunk_size)."
            )
        if self.dtype not in ("float32", "bfloat16"):
            raise ValueError(f"dtype is {self.dtype!r}, but must be float32 or bfloat16.")

    @property
    def observation_delta_indices(self) -> list[int]:
        """The current frame, and the one to predict."""
        return [0, self.chunk_size]

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
            raise ValueError(f"upvla needs an image, but the inputs are {sorted(self.input_features or {})}.")
        if self.action_feature is None or len(self.action_feature.shape) != 1:
            raise ValueError(f"'action' must be a flat vector, but the outputs are {self.output_features}.")

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return AdamW."""
        return AdamWConfig(lr=self.optimizer_lr, weight_decay=self.optimizer_weight_decay)

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        """Return a warm-up and a cosine to zero, as UP-VLA's."""
        return CosineDecayWithWarmupSchedulerConfig(
            peak_lr=self.optimizer_lr,
            decay_lr=0.0,
            num_warmup_steps=self.scheduler_warmup_steps,
            num_decay_steps=self.scheduler_decay_steps,
        )
