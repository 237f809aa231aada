"""The interface of action heads: a training loss and a sampler over chunks of actions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor, nn

from ..registry import Registry
from ..track import Track

heads: Registry[type[ActionHead]] = Registry("head")

Velocity = Callable[[Tensor], Tensor]
"""Flow velocity as a function of a noisy chunk, ``(B, H, A) -> (B, H, A)``."""

Guide = Callable[[Tensor, float, Velocity], Tensor]
"""Guidance of a flow: ``guide(x_t, t, velocity)`` returns the guided velocity ``(B, H, A)``; t = 0 noise, 1 data."""


@dataclass(frozen=True)
class ActionSpec:
    """Sizes of an action head and of its inputs.

    Attributes:
        horizon: actions in a chunk, ``H``.
        action_dim: size of an action, ``A``.
        state_dim: size of the proprioceptive vector, ``S``; 0 where the dataset has none.
        width: size of the condition tokens, ``D``.
        n_heads: attention heads.
        dropout: dropout probability.
        fps: frame rate [Hz].
        latency_frames: leading actions of a chunk that lie in the past when it is ready.
    """

    horizon: int
    action_dim: int
    state_dim: int
    width: int
    n_heads: int
    dropout: float
    fps: float = 20.0
    latency_frames: int = 0


@dataclass(frozen=True)
class Prefix:
    """Actions that a hand has committed to: a chunk continues them.

    Attributes:
        actions: in the frame of `ActionFrame`, shape ``(B, D, A)``.
        length: how many of them are executed, shape ``(B,)``.
    """

    actions: Tensor
    length: Tensor


@dataclass(frozen=True)
class Condition:
    """What a chunk is conditioned on.

    Attributes:
        tokens: fused image, proprioception and text tokens, shape ``(B, N, D)``.
        state: current proprioception, normalised, shape ``(B, S)``.
        position: current ``observation.state``, normalised, shape ``(B, P)``.
        track: where the target has been seen, if the backbone is an eye.
        prefix: what the hand does before the chunk that is asked for takes over; None for nothing.
    """

    tokens: Tensor
    state: Tensor
    position: Tensor
    track: Track | None = None
    prefix: Prefix | None = None

    def repeat(self, n: int) -> Condition:
        """Return the condition with every row repeated ``n`` times, ``(B * n, ...)``."""
        tokens, state, position = (x.repeat_interleave(n, 0) for x in (self.tokens, self.state, self.position))
        return Condition(tokens, state, position, self.track)


class ActionHead(nn.Module, ABC):
    """Says which chunk of actions to execute, in the frame of `ActionFrame`.

    A subclass takes an `ActionSpec` first and its own options as keywords.

    Args:
        spec: sizes of the head and of its inputs.
    """

    accepts_guide: ClassVar[bool] = False
    accepts_prefix: ClassVar[bool] = False

    def __init__(self, spec: ActionSpec) -> None:
        super().__init__()
        self.spec = spec

    @property
    def noise_dim(self) -> int:
        """Last size of the noise that `sample` takes; more than an action where the head pads actions."""
        return self.spec.action_dim

    def load_pretrained(self) -> None:
        """Load published weights, if there are any; called when training starts, not when a checkpoint is opened."""

    @abstractmethod
    def sample(self, condition: Condition, noise: Tensor, guide: Guide | None = None) -> Tensor:
        """Sample a chunk: map standard normal noise ``(B, H, noise_dim)`` to ``(B, H, A)``.

        Args:
            condition: what the chunk is conditioned on.
            noise: start of the sampling, standard normal.
            guide: steers the flow, for heads with ``accepts_guide``.

        Returns:
            The chunk. With a prefix of up to D actions, a head with ``accepts_prefix`` puts them first,
            ``(B, D + H, A)``.
        """


class ChunkHead(ActionHead):
    """A conditional distribution over action chunks, learned from chunks."""

    @abstractmethod
    def loss(self, actions: Tensor, condition: Condition) -> Tensor:
        """Return the training loss of each entry, ``(B, H, A) -> (B, H, A)``."""


@dataclass(frozen=True)
class Forecast:
    """What is predicted for ``R`` decisions, and what it is compared with.

    Attributes:
        path: offsets of the target from the palm of the current frame, at ``K`` times ahead [m], shape ``(R, K, 3)``.
        closed: joint angles that close the hand around the target [rad], shape ``(R, J)``.
    """

    path: Tensor
    closed: Tensor


class ForecastHead(ActionHead):
    """Predicts where the target goes, learns from where it went, and derives the chunk from the prediction."""

    def sample(self, condition: Condition, noise: Tensor, guide: Guide | None = None) -> Tensor:
        """See `ActionHead.sample`; the noise is ignored."""
        return self.chunk(self.forecast(condition), condition)

    @abstractmethod
    def forecast(self, condition: Condition) -> Forecast:
        """Predict the path and the grasp."""

    @abstractmethod
    def chunk(self, forecast: Forecast, condition: Condition) -> Tensor:
        """Return the chunk that follows from a forecast, see `ActionHead.sample`."""

    @abstractmethod
    def path(self, forecast: Forecast) -> Tensor:
        """Return the path at every frame from 0 to F ahead, ``(R, F + 1, 3)`` [m]."""

    @abstractmethod
    def moves(self, path: Tensor, closed: Tensor, start: Tensor, n_steps: int) -> Tensor:
        """Return the first ``n_steps`` targets of hands that go to meet their targets, ``(R, n_steps, A)``.

        Args:
            path: where the targets will be, from the frame on in which the hands start, shape ``(R, F + 1, 3)`` [m].
            closed: joint angles that close the hand around the target, shape ``(R, J)`` [rad].
            start: palm [m] and joints [rad], the palm in the frame of the path, shape ``(R, A)``.
            n_steps: how many are wanted.
        """

    @abstractmethod
    def forecast_loss(self, label: Forecast, condition: Condition, arrival: Tensor, known: Tensor) -> Tensor:
        """Return the loss of each decision, shape ``(R,)``.

        Args:
            label: the true path and grasp.
            condition: what the forecast is conditioned on.
            arrival: frames until a teacher meets the target, shape ``(R,)``.
            known: False where the true path is not known, shape ``(R, K)``.
        """
