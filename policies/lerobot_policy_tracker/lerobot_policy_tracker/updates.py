"""One update of weights: a scheduled learning rate, a loss that must be finite, clipped gradients."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor


def learning_rate(peak: float, update: int, n_updates: int, warmup: int) -> float:
    """Return the rate of an update, counted from 0: a linear warm-up, then a cosine down to a fiftieth of the peak."""
    progress = min(update / max(n_updates, 1), 1.0)
    return peak * min(1.0, (update + 1) / warmup) * (0.02 + 0.49 * (1 + math.cos(math.pi * progress)))


def take_step(
    optimizer: torch.optim.Optimizer, loss: Tensor, clipped: Iterable[Tensor], *, max_norm: float, rate: float, n: int
) -> float:
    """Descend the gradient of a loss by one step, and return the loss.

    Args:
        optimizer: of the weights.
        loss: a scalar.
        clipped: the parameters whose gradients are clipped together.
        max_norm: of these gradients.
        rate: learning rate of all parameter groups.
        n: number of the update, for the message.

    Raises:
        FloatingPointError: if the loss is not finite; no weight has changed then.
    """
    value = loss.item()  # the one wait for the device in an update
    if not math.isfinite(value):
        raise FloatingPointError(f"the loss of update {n} is {value}; lower learning_rate")
    for group in optimizer.param_groups:
        group["lr"] = rate
    optimizer.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(clipped, max_norm)
    optimizer.step()
    return value
