"""Exponential moving average (EMA) of the weights: acting uses the average, training the weights themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

if TYPE_CHECKING:
    from .modeling_tracker import TrackerPolicy


def averaged_copy(model: nn.Module, decay: float) -> AveragedModel:
    """Return a copy of ``model`` that follows it as an exponential moving average.

    Args:
        model: the network that is trained.
        decay: decay per update, reached gradually, ``min(decay, (1 + n) / (10 + n))`` after ``n`` updates, so that the
            average soon forgets the random initial weights.
    """

    def average(averaged: Any, current: Any, n_averaged: Any) -> None:
        n = int(n_averaged)
        get_ema_multi_avg_fn(min(decay, (1 + n) / (10 + n)))(averaged, current, n_averaged)

    return AveragedModel(model, multi_avg_fn=average).requires_grad_(False)


def match_averages(policy: TrackerPolicy, state: dict[str, Tensor], prefix: str, *_: Any) -> None:
    """Let a checkpoint with or without averaged weights load into a policy without or with them.

    A pre-hook of ``load_state_dict``. A policy without an average takes the checkpoint's average as its weights; one
    with an average starts it from the checkpoint's weights.

    Args:
        policy: the policy that loads the checkpoint.
        state: state dict of the checkpoint, changed in place.
        prefix: what the policy's own keys in it begin with.
        *_: what else PyTorch passes to such a hook, unused.
    """
    plain, averaged = f"{prefix}model.", f"{prefix}ema.module."
    found = {key: value for key, value in state.items() if key.startswith(averaged)}
    if policy.ema is None:
        for key in [key for key in state if key.startswith(f"{prefix}ema.")]:
            del state[key]
        state.update({plain + key.removeprefix(averaged): value for key, value in found.items()})
    elif not found:
        weights = {key: value for key, value in state.items() if key.startswith(plain)}
        state.update({averaged + key.removeprefix(plain): value for key, value in weights.items()})
        state[f"{prefix}ema.n_averaged"] = policy.ema.n_averaged
