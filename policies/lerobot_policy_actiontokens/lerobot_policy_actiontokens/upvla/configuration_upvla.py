"""The config of ``--policy.type=upvla``."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig
from lerobot.optim import CosineDecayWithWarmupSchedulerConfig

from lerobot_policy_actiontokens.chunks import ChunkConfig


@PreTrainedConfig.register_subclass("upvla")
@dataclass
class UPVLAConfig(ChunkConfig):
    """A language model that reads an image as codes, and predicts its future and the actions together.

    Attributes:
        llm_name: Folder or Hub name of any causal language model of `transformers`, with its tokenizer.
        image_tokenizer: Folder or Hub name of a `diffusers` ``VQModel``, which turns images into codes.
        image_tokenizer_folder: Where in there it is.
        image_size: Side of the square image that is turned into codes [px].
        chunk_size: Actions predicted at a time; the image is predicted as many frames ahead.
        prediction_weight: Weight of the image's cross-entropy in the loss.
        action_weight: Weight of the actions' squared error.
        n_heads: Attention heads of the pooling before the action head.
    """

    llm_name: str = "microsoft/phi-1_5"
    image_tokenizer: str = "amused/amused-256"
    image_tokenizer_folder: str = "vqvae"
    image_size: int = 256
    chunk_size: int = 10
    n_action_steps: int = 10
    prediction_weight: float = 1.0
    action_weight: float = 1.0
    n_heads: int = 8
    optimizer_lr: float = 1e-4
    optimizer_weight_decay: float = 0.01
    scheduler_warmup_steps: int = 1000
    scheduler_decay_steps: int = 200_000

    @property
    def observation_delta_indices(self) -> list[int]:
        """The current frame, and the one to predict."""
        return [0, self.chunk_size]

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        """Return a warm-up and a cosine to zero, as UP-VLA's."""
        return CosineDecayWithWarmupSchedulerConfig(
            peak_lr=self.optimizer_lr,
            decay_lr=0.0,
            num_warmup_steps=self.scheduler_warmup_steps,
            num_decay_steps=self.scheduler_decay_steps,
        )
