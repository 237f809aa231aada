"""Base classes of policies that predict a chunk of actions from one image and an instruction."""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from draccus.utils import ParsingError
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor
from transformers import AutoConfig


@dataclass
class ChunkConfig(PreTrainedConfig):
    """Options of all these policies.

    Attributes:
        load_weights: whether the parts start from their published weights; a checkpoint holds its
            own.
        chunk_size: actions in a predicted chunk, ``H``.
        n_action_steps: actions of a chunk that are executed before the policy replans.
        dtype: data type of the weights, "float32" or "bfloat16".
    """

    load_weights: bool = True
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
        # LeRobot's command line shows what this error says, and hides what a ValueError says
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise ParsingError(
                f"n_action_steps is {self.n_action_steps}, but must be 1 to {self.chunk_size} "
                f"(chunk_size)."
            )
        if self.n_obs_steps != 1:
            raise ParsingError(
                f"n_obs_steps is {self.n_obs_steps}, but must be 1: this policy sees one frame."
            )
        if self.dtype not in ("float32", "bfloat16"):
            raise ParsingError(f"dtype is {self.dtype!r}, but must be float32 or bfloat16.")

    @property
    def action_delta_indices(self) -> list[int]:
        """Actions LeRobot loads, relative to the sample [frames]."""
        return list(range(self.chunk_size))

    @property
    def reward_delta_indices(self) -> None:
        """None: imitation learning uses no rewards."""
        return

    @property
    def action_dim(self) -> int:
        """Size of an action, ``A``; 0 without an action."""
        return self.action_feature.shape[0] if self.action_feature else 0

    def validate_features(self) -> None:
        """Check that the dataset has the features the policy needs.

        Raises:
            ValueError: if there is no image, more than one, or no flat action.
        """
        if not self.image_features:
            raise ValueError(
                f"{self.type} needs an image, but the inputs are "
                f"{sorted(self.input_features or {})}."
            )
        if len(self.image_features) > 1:
            raise ValueError(
                f"{self.type} sees one image, but the inputs have "
                f"{', '.join(self.image_features)}; name one in --policy.input_features."
            )
        if self.action_feature is None or len(self.action_feature.shape) != 1:
            raise ValueError(
                f"'action' must be a flat vector, but the outputs are {self.output_features}."
            )

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return AdamW with the learning rate and weight decay of the config."""
        return AdamWConfig(lr=self.optimizer_lr, weight_decay=self.optimizer_weight_decay)


class ChunkPolicy(PreTrainedPolicy):
    """A policy that executes ``n_action_steps`` of a chunk before it predicts the next.

    A subclass implements ``forward`` and ``predict_action_chunk``, and sets its own
    ``config_class`` and ``name``.

    Args:
        config: the policy's config, with its features filled in.
    """

    config_class: ClassVar[type[ChunkConfig]] = ChunkConfig
    name: ClassVar[str] = "chunk"
    config: ChunkConfig

    def __init__(self, config: ChunkConfig) -> None:
        super().__init__(config)
        config.validate_features()
        self.reset()

    @torch.no_grad()
    def select_action(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Return the next action, normalized, shape ``(B, A)``; predicts a new chunk when the last
        one is used up.
        """
        if not self._queue:
            chunk = self.predict_action_chunk(batch)[:, : self.config.n_action_steps]
            self._queue.extend(chunk.transpose(0, 1))
        return self._queue.popleft()

    def reset(self) -> None:
        """Forget the last episode."""
        self._queue: deque[Tensor] = deque()

    def get_optim_params(self) -> Any:
        """Return the trained parameters."""
        return [p for p in self.parameters() if p.requires_grad]

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Open a checkpoint; its own weights replace the published ones, which are not read."""
        config = kwargs.pop("config", None) or cls.config_class.from_pretrained(
            pretrained_name_or_path
        )
        config.load_weights = False
        return super().from_pretrained(pretrained_name_or_path, config=config, **kwargs)

    @property
    def camera(self) -> str:
        """Key of the image that the policy sees."""
        return next(iter(self.config.image_features))


def open_model(model_class: Any, name: str, config: ChunkConfig) -> Any:
    """Return a `transformers` model, with its published weights if the config says so, else random
    ones.

    Args:
        model_class: the `transformers` class that opens it, such as ``AutoModelForCausalLM``.
        name: folder or Hub name.
        config: the policy's config, for data type and ``load_weights``.
    """
    dtype = getattr(torch, config.dtype)
    if config.load_weights:
        return model_class.from_pretrained(name, dtype=dtype)
    return model_class.from_config(AutoConfig.from_pretrained(name), dtype=dtype)


def unpadded(batch: dict[str, Any], key: str, like: Tensor) -> Tensor:
    """Return the padding mask of ``key``, 1 within the episode and 0 beyond it, shape ``(B, T)``.

    Args:
        batch: preprocessed LeRobot batch.
        key: feature whose mask is returned.
        like: tensor of the mask's shape and data type.
    """
    pad = batch.get(f"{key}_is_pad")
    return torch.ones_like(like) if pad is None else (~pad.bool()).to(like.dtype)


def instructions(batch: dict[str, Any], n: int) -> list[str]:
    """Return the instruction of each of the ``n`` samples of a batch."""
    return [batch["task"]] * n if isinstance(batch["task"], str) else batch["task"]
