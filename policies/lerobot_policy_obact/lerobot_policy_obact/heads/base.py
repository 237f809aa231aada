"""What every action head offers: a training loss and a sampler over chunks of actions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor, nn

from ..registry import Registry

heads: Registry[type[ActionHead]] = Registry("head")

Velocity = Callable[[Tensor], Tensor]
"""Flow velocity as a function of a noisy chunk, ``(B, H, A) -> (B, H, A)``."""

Guide = Callable[[Tensor, float, Velocity], Tensor]
"""Replaces a velocity: ``guide(x_t, t, velocity)`` returns the guided one, ``(B, H, A)``; t = 0 noise, t = 1
data.
"""


@dataclass(frozen=True)
class ActionSpec:
    """What a head is built for.

    Attributes:
        horizon: Actions in a chunk, ``H``.
        action_dim: Size of an action, ``A``.
        state_dim: Size of the proprioceptive vector, ``S``; 0 where the dataset has none.
        width: Size of the condition tokens, ``D``.
        n_heads: Attention heads.
        dropout: Dropout probability.
    """

    horizon: int
    action_dim: int
    state_dim: int
    width: int
    n_heads: int
    dropout: float


@dataclass(frozen=True)
class Condition:
    """What a chunk is conditioned on.

    Attributes:
        tokens: What was seen and said, shape ``(B, N, D)``.
        state: Current proprioception, normalised, shape ``(B, S)``.
    """

    tokens: Tensor
    state: Tensor

    def repeat(self, n: int) -> Condition:
        """Return the condition with every row ``n`` times in a row, ``(B * n, ...)``."""
        return Condition(self.tokens.repeat_interleave(n, 0), self.state.repeat_interleave(n, 0))


class ActionHead(nn.Module, ABC):
    """A conditional distribution over action chunks in the frame of `ActionFrame`.

    A subclass takes an `ActionSpec` first and its own options as keywords.

    Args:
        spec: What the head is built for.
    """

    accepts_guide: ClassVar[bool] = False

    def __init__(self, spec: ActionSpec) -> None:
        super().__init__()
        self.spec = spec

    @property
    def noise_dim(self) -> int:
        """Last size of the noise that `sample` takes; more than an action where the head pads actions."""
        return self.spec.action_dim

    def load_pretrained(self) -> None:
        """Start from published weights, for heads that have any. Called when training starts, not when it resumes."""

    @abstractmethod
    def loss(self, actions: Tensor, condition: Condition) -> Tensor:
        """Return the training loss of each entry, ``(B, H, A) -> (B, H, A)``."""

    @abstractmethod
    def sample(self, condition: Condition, noise: Tensor, guide: Guide | None = None) -> Tensor:
        """Turn standard normal noise ``(B, H, noise_dim)`` into a chunk ``(B, H, A)``.

        Args:
            condition: What the chunk is conditioned on.
            noise: Where sampling starts.
            guide: Steers the flow, for heads with ``accepts_guide``.
        """
