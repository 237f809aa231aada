"""The config of ``--policy.type=actiontokens``."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig

from . import openvla  # noqa: F401, so that transformers opens its checkpoints
from .chunks import ChunkConfig


@PreTrainedConfig.register_subclass("actiontokens")
@dataclass
class ActionTokensConfig(ChunkConfig):
    """A vision-language model that writes actions.

    Attributes:
        vlm_name: Folder or Hub name of any image-text model of `transformers`, with its processor, or of OpenVLA.
        unnorm_key: Dataset among an OpenVLA checkpoint's ``norm_stats`` by whose percentiles actions are normalised;
            none for those of the data that is trained on.
        freeze_vision: Leave the vision tower as it is.
    """

    vlm_name: str = "HuggingFaceTB/SmolVLM2-500M-Video-Instruct"
    unnorm_key: str | None = None
    freeze_vision: bool = True

    @property
    def observation_delta_indices(self) -> None:
        """The current frame alone."""
        return

    def get_scheduler_preset(self) -> None:
        """Keep the learning rate, as OpenVLA does."""
        return
