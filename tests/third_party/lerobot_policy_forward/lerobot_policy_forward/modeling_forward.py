"""A policy that always moves by the same learned step."""

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor, nn

from .configuration_forward import ForwardConfig


class ForwardPolicy(PreTrainedPolicy):
    config_class = ForwardConfig
    name = "forward"

    def __init__(self, config: ForwardConfig, **_: object) -> None:
        super().__init__(config)
        self.step = nn.Parameter(torch.zeros(18))

    def get_optim_params(self) -> list[dict]:
        return [{"params": list(self.parameters())}]

    def reset(self) -> None:
        pass

    def select_action(self, batch: dict[str, Tensor], **_: object) -> Tensor:
        """Return the (B, 18) state moved by the step."""
        return batch["observation.state"] + self.step

    def predict_action_chunk(self, batch: dict[str, Tensor], **_: object) -> Tensor:
        return self.select_action(batch)[:, None]

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, None]:
        return nn.functional.mse_loss(self.select_action(batch), batch["action"]), None
