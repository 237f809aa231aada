"""Flow matching (Lipman et al., 2023) with a diffusion transformer.

Time runs from noise to data: t = 0 is noise, t = 1 is the chunk.

    x_t = (1 - t) eps + t a          the straight path from noise eps to actions a
    v*  = a - eps                    its velocity, which the network learns to predict from (x_t, t,
    condition)

Where the condition nearly determines the chunk, as with a deterministic expert, the network may predict the chunk
itself instead ("chunk"; Li and He, 2025, argue for it in general): it can then ignore x_t, and its velocity follows as

    v = (a - x_t) / (1 - t)

Training times are skewed towards noise, where the mode of the chunk is determined: ``t = 0.999 (1 - u)`` with ``u ~
Beta(1.5, 1)``, as in GR00T-N1.5. Acting integrates the velocity from 0 to 1 with a few Euler steps.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from .base import ActionSpec, ChunkHead, Condition, Guide, heads
from .dit import DiT

MAX_TIME = 0.999
PREDICTS = ("velocity", "chunk")


def sample_flow_times(n: int, device: torch.device, skew: float = 1.5) -> Tensor:
    """Draw flow times, shape ``(n,)``; ``u ~ Beta(skew, 1)`` has the distribution function ``u ** skew``."""
    return MAX_TIME * (1 - torch.rand(n, device=device) ** (1 / skew))


def integrate(
    velocity: Callable[[Tensor, Tensor], Tensor], noise: Tensor, n_steps: int, guide: Guide | None = None
) -> Tensor:
    """Integrate a velocity from t = 0 to t = 1 with Euler steps.

    Args:
        velocity: ``velocity(x_t, t) -> (B, H, A)`` with t of shape ``(B,)``.
        noise: start of the integration, shape ``(B, H, A)``.
        n_steps: Euler steps.
        guide: guidance of every step, if any.

    Returns:
        Chunk, shape ``(B, H, A)``.
    """
    x = noise
    for step in range(n_steps):
        t = torch.full((len(x),), step / n_steps, device=x.device)
        v = velocity(x, t) if guide is None else guide(x, step / n_steps, lambda x_t, t=t: velocity(x_t, t))
        x = x + v / n_steps
    return x


@heads.register("flow")
class FlowHead(ChunkHead):
    """Flow matching over a `DiT`.

    Args:
        spec: sizes of the head and of its inputs.
        n_layers: transformer blocks.
        n_steps: Euler steps of a chunk.
        n_draws: noise samples per chunk in training; several reuse each encoded frame, the most expensive part.
        predicts: output of the network, "velocity" or "chunk".

    Raises:
        ValueError: if ``predicts`` is neither.
    """

    accepts_guide = True

    def __init__(
        self, spec: ActionSpec, *, n_layers: int = 4, n_steps: int = 4, n_draws: int = 1, predicts: str = "velocity"
    ) -> None:
        super().__init__(spec)
        if predicts not in PREDICTS:
            raise ValueError(f"predicts is {predicts!r}, but must be one of {', '.join(PREDICTS)}.")
        self.n_steps, self.n_draws, self.predicts = n_steps, n_draws, predicts
        self.net = DiT(spec, n_layers)

    def loss(self, actions: Tensor, condition: Condition) -> Tensor:
        """See `ChunkHead.loss`."""
        target, condition = actions.repeat_interleave(self.n_draws, 0), condition.repeat(self.n_draws)
        t = sample_flow_times(len(target), target.device)
        noise = torch.randn_like(target)
        x_t = torch.lerp(noise, target, t[:, None, None])
        error = self.net(x_t, t, condition) - (target if self.predicts == "chunk" else target - noise)
        return error.square().unflatten(0, (-1, self.n_draws)).mean(1)  # (B * draws, H, A) -> (B, H, A)

    def sample(self, condition: Condition, noise: Tensor, guide: Guide | None = None) -> Tensor:
        """See `ActionHead.sample`."""
        return integrate(lambda x, t: self._velocity(x, t, condition), noise, self.n_steps, guide)

    def _velocity(self, x: Tensor, t: Tensor, condition: Condition) -> Tensor:
        predicted = self.net(x, t, condition)  # (B, H, A)
        return (predicted - x) / (1 - t)[:, None, None] if self.predicts == "chunk" else predicted
