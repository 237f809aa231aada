"""Configuration of ``--policy.type=actiontokens``."""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig

from . import openvla  # noqa: F401, so that transformers opens its checkpoints
from .chunks import ChunkConfig


@PreTrainedConfig.register_subclass("actiontokens")
@dataclass
class ActionTokensConfig(ChunkConfig):
    """A vision-language model that predicts actions as tokens.

    Attributes:
        vlm_name: folder or Hub name of any image-text model of `transformers` with its processor,
            or of an OpenVLA checkpoint.
        unnorm_key: dataset in an OpenVLA checkpoint's ``norm_stats`` whose percentiles normalize
            the actions; None uses those of the training data.
        freeze_vision: whether the vision tower is excluded from training.
    """

    vlm_name: str = "HuggingFaceTB/SmolVLM2-500M-Video-Instruct"
    unnorm_key: str | None = None
    freeze_vision: bool = True

    @property
    def observation_delta_indices(self) -> None:
        """None: the policy sees the current frame only."""
        return

    def get_scheduler_preset(self) -> None:
        """Return None: the learning rate is constant, as in OpenVLA."""
        return
