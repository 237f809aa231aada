"""What policies share that write a chunk of actions at a time from one image and an instruction."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import torch
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig
from torch import Tensor
from transformers import AutoConfig


@dataclass
class ChunkConfig(PreTrainedConfig):
    """Chunks, weights and normalisation.

    Attributes:
        load_weights: Start from the published weights of what it is made of; a checkpoint brings its own.
        chunk_size: Actions written at a time.
        n_action_steps: How many of them are executed.
        dtype: Of the weights, "float32" or "bfloat16".
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
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise ValueError(
                f"n_action_steps is {self.n_action_steps}, but must be 1 to {self.chunk_size} (chunk_size)."
            )
        if self.dtype not in ("float32", "bfloat16"):
            raise ValueError(f"dtype is {self.dtype!r}, but must be float32 or bfloat16.")

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
            raise ValueError(f"{self.type} needs an image, but the inputs are {sorted(self.input_features or {})}.")
        if self.action_feature is None or len(self.action_feature.shape) != 1:
            raise ValueError(f"'action' must be a flat vector, but the outputs are {self.output_features}.")

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return AdamW."""
        return AdamWConfig(lr=self.optimizer_lr, weight_decay=self.optimizer_weight_decay)


class Chunks:
    """A LeRobot policy with this before ``PreTrainedPolicy`` plays a chunk to the end before it writes the next."""

    config: Any

    @torch.no_grad()
    def select_action(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Return the next action, shape ``(B, A)``, normalised; a new chunk when the last one is used up."""
        if not self._queue:
            chunk = self.predict_action_chunk(batch)[:, : self.config.n_action_steps]
            self._queue.extend(chunk.transpose(0, 1))
        return self._queue.popleft()

    def reset(self) -> None:
        """Forget the last episode."""
        self._queue: deque[Tensor] = deque()

    def get_optim_params(self) -> list[Tensor]:
        """Return what is trained."""
        return [p for p in self.parameters() if p.requires_grad]

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Open a checkpoint, which carries its own weights."""
        config = kwargs.pop("config", None) or cls.config_class.from_pretrained(pretrained_name_or_path)
        config.load_weights = False
        return super().from_pretrained(pretrained_name_or_path, config=config, **kwargs)

    @property
    def camera(self) -> str:
        """Key of the image that it sees, the first."""
        return next(iter(self.config.image_features))


def open_model(kind: Any, name: str, config: ChunkConfig) -> Any:
    """Return the model ``name`` of `transformers`, with its published weights if the config says so.

    Args:
        kind: the `transformers` class that opens it, as ``AutoModelForCausalLM``.
        name: folder or Hub name.
        config: of the policy.
    """
    dtype = getattr(torch, config.dtype)
    if config.load_weights:
        return kind.from_pretrained(name, dtype=dtype)
    return kind.from_config(AutoConfig.from_pretrained(name), dtype=dtype)


def within(batch: dict[str, Any], key: str, like: Tensor) -> Tensor:
    """Return (B, T), 1 for the frames of ``key`` that are within the episode, 0 for padding, as ``like`` (B, T)."""
    pad = batch.get(f"{key}_is_pad")
    return torch.ones_like(like) if pad is None else (~pad.bool()).to(like.dtype)


def instructions(batch: dict[str, Any], n: int) -> list[str]:
    """Return the instruction of each of ``n`` samples."""
    return [batch["task"]] * n if isinstance(batch["task"], str) else batch["task"]
