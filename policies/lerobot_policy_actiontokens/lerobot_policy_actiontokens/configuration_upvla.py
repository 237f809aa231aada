"""Configuration of ``--policy.type=upvla``."""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig
from lerobot.optim import CosineDecayWithWarmupSchedulerConfig

from .chunks import ChunkConfig


@PreTrainedConfig.register_subclass("upvla")
@dataclass
class UPVLAConfig(ChunkConfig):
    """A language model over image codes that jointly predicts a future image and a chunk of
    actions.

    Attributes:
        llm_name: folder or Hub name of any causal language model of `transformers`, with its
            tokenizer.
        image_tokenizer: folder or Hub name of a `diffusers` ``VQModel``, which encodes images.
        image_tokenizer_folder: its subfolder; "" for none.
        image_size: side of the square image that is encoded [px].
        chunk_size: actions in a predicted chunk; the image is predicted as many frames ahead.
        prediction_weight: weight of the image's cross-entropy in the loss.
        action_weight: weight of the actions' squared error.
        n_heads: attention heads of the pooling before the action head.
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
        """Frames LeRobot loads: the current one, and the one to predict [frames]."""
        return [0, self.chunk_size]

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        """Return a warm-up and a cosine decay to zero, as in UP-VLA."""
        return CosineDecayWithWarmupSchedulerConfig(
            peak_lr=self.optimizer_lr,
            decay_lr=0.0,
            num_warmup_steps=self.scheduler_warmup_steps,
            num_decay_steps=self.scheduler_decay_steps,
        )
