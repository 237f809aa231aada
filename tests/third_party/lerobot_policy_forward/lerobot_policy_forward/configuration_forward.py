"""Configuration of the policy ``forward``."""

from dataclasses import dataclass, field

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamConfig


@PreTrainedConfig.register_subclass("forward")
@dataclass
class ForwardConfig(PreTrainedConfig):
    """``lr``: learning rate; ``normalization_mapping``: LeRobot's, here none."""

    lr: float = 0.01
    normalization_mapping: dict[str, NormalizationMode] = field(default_factory=dict)
    observation_delta_indices = None
    action_delta_indices = None
    reward_delta_indices = None

    def get_optimizer_preset(self) -> AdamConfig:
        return AdamConfig(lr=self.lr)

    def get_scheduler_preset(self) -> None:
        return None

    def validate_features(self) -> None:
        pass
