"""The frame in which actions are predicted: as recorded, or as displacements from where the hand is now.

The camera moves with the hand, so an image tells where the target is *relative to the palm*. A chunk of
absolute palm targets would force the network to add the palm position to everything it sees; a chunk of
displacements does not.

LeRobot normalises actions and states separately before a policy sees them, so their difference in normalised
units means nothing. `ActionFrame` undoes both scalings (the constants are buffers), subtracts in
physical units, and divides by the spread of the displacements:

    r = (a - p) / spread,   a = action_scale * a_n + action_shift,   p = state_scale * s_n + state_shift

Pre- and postprocessors stay LeRobot's own, and a chunk is anchored at the state it was planned from, not at
the state at which its actions happen to be executed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from lerobot.configs import NormalizationMode
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor, nn

from .configuration_tracker import TrackerConfig

# The spread is measured on the first training batches and then stays fixed: the targets of training must not drift.
N_SPREAD_BATCHES = 100

MIN_SPREAD = 1e-4
"""Smallest spread of a displacement, in the unit of the action: 0.1 mm for positions in metres. A hand that moves less
is at rest, and the rounding of its position must not be scaled up to the size of a motion."""

_RANGE_KEYS = {
    NormalizationMode.MIN_MAX: ("min", "max"),
    NormalizationMode.QUANTILES: ("q01", "q99"),
    NormalizationMode.QUANTILE10: ("q10", "q90"),
}


def affine_of(stats: dict[str, Any] | None, mode: NormalizationMode) -> tuple[Tensor, Tensor] | None:
    """Return ``(scale, shift)`` with ``physical = scale * normalised + shift``, or None where nothing is
    scaled.

    Args:
        stats: one feature's LeRobot statistics, arrays of shape ``(D,)``.
        mode: how LeRobot normalises the feature.
    """
    if stats is None or mode is NormalizationMode.IDENTITY:
        return None
    first, second = _RANGE_KEYS.get(mode, ("mean", "std"))
    first, second = (torch.as_tensor(stats[key], dtype=torch.float32).flatten() for key in (first, second))
    if mode is NormalizationMode.MEAN_STD:
        return second, first
    return (second - first) / 2, (second + first) / 2


def looks_absolute(action_stats: dict[str, Any], state_stats: dict[str, Any], n_dims: int) -> bool:
    """Return whether the leading actions look like targets in the coordinates of the leading states.

    A position target follows the position, so both have about the same mean and standard deviation. Those of a velocity
    or an increment differ.

    Args:
        action_stats: LeRobot statistics of ``action``, arrays of shape ``(A,)``.
        state_stats: LeRobot statistics of ``observation.state``, arrays of shape ``(S,)``.
        n_dims: leading dimensions to compare.
    """
    stats = (action_stats["mean"], action_stats["std"], state_stats["mean"], state_stats["std"])
    action_mean, action_std, state_mean, state_std = (
        torch.as_tensor(value, dtype=torch.float32).flatten()[:n_dims] for value in stats
    )
    ratio = action_std / state_std.clamp_min(1e-8)
    close = (action_mean - state_mean).abs() <= 0.5 * torch.maximum(action_std, state_std)
    return bool((close & (ratio > 0.5) & (ratio < 2.0)).all())


def resolve_action_frame(config: TrackerConfig, stats: dict[str, dict[str, Any]] | None) -> str:
    """Return the config's ``action_frame`` with "auto" resolved.

    Args:
        config: the policy's config.
        stats: LeRobot statistics of the training data; without them "auto" is "absolute".
    """
    if config.action_frame != "auto":
        return config.action_frame
    if not config.can_be_relative or not stats or ACTION not in stats or OBS_STATE not in stats:
        return "absolute"
    return "relative" if looks_absolute(stats[ACTION], stats[OBS_STATE], config.relative_dims) else "absolute"


class ActionFrame(nn.Module):
    """Maps normalised actions to the frame the head predicts, and back.

    Args:
        n_dims: leading dimensions that are relative to ``observation.state``; 0 makes the map the identity.
    """

    action_scale: Tensor
    action_shift: Tensor
    state_scale: Tensor
    state_shift: Tensor
    mean_square: Tensor
    n_batches: Tensor

    def __init__(self, n_dims: int) -> None:
        super().__init__()
        self.n_dims = n_dims
        for name in ("action", "state"):
            self.register_buffer(f"{name}_scale", torch.ones(n_dims))
            self.register_buffer(f"{name}_shift", torch.zeros(n_dims))
        self.register_buffer("mean_square", torch.ones(n_dims))
        self.register_buffer("n_batches", torch.zeros((), dtype=torch.long))

    def set_stats(self, name: str, affine: tuple[Tensor, Tensor] | None) -> None:
        """Store the constants of a normalisation, ``physical = scale * normalised + shift``.

        Args:
            name: "action" or "state".
            affine: ``(scale, shift)``, each of shape ``(D,)``; None where LeRobot does not normalise.
        """
        scale, shift = affine or (torch.ones(self.n_dims), torch.zeros(self.n_dims))
        getattr(self, f"{name}_scale").copy_(scale[: self.n_dims].clamp_min(1e-8))
        getattr(self, f"{name}_shift").copy_(shift[: self.n_dims])

    def set_dataset_stats(self, stats: dict[str, dict[str, Any]], mapping: Mapping[str, NormalizationMode]) -> None:
        """Store the constants with which LeRobot normalises actions and states.

        Args:
            stats: LeRobot statistics by feature key.
            mapping: normalisation mode by feature type, ``config.normalization_mapping``.
        """
        for name, key in (("action", ACTION), ("state", OBS_STATE)):
            mode = mapping.get(name.upper(), NormalizationMode.IDENTITY)
            self.set_stats(name, affine_of(stats.get(key), mode))

    def observe(self, actions: Tensor, state: Tensor, keep: Tensor) -> None:
        """Update the running spread of the displacements with one training batch.

        Args:
            actions: normalised actions, shape ``(B, H, A)``.
            state: normalised ``observation.state`` at the decision, shape ``(B, S)``.
            keep: False where an action is padding, shape ``(B, H)``.
        """
        if self.n_dims == 0 or self.n_batches >= N_SPREAD_BATCHES or not keep.any():
            return
        square = self._displacement(actions, state).detach()[keep].square().mean(0)
        self.n_batches += 1
        # Unlike mean += (x - mean) / n, lerp returns x itself at weight 1: the initial value leaves no rounding behind.
        self.mean_square.lerp_(square, self.n_batches.reciprocal())

    @property
    def spread(self) -> Tensor:
        """Root mean square of the displacements in the unit of the action, at least `MIN_SPREAD`, ``(n_dims,)``."""
        return self.mean_square.sqrt().clamp_min(MIN_SPREAD)

    def to_model(self, actions: Tensor, state: Tensor) -> Tensor:
        """Map normalised actions ``(B, H, A)`` to the head's frame, given the normalised state ``(B, S)``."""
        relative = self._displacement(actions, state) / self.spread
        return torch.cat([relative, actions[..., self.n_dims :]], dim=-1)

    def to_actions(self, chunk: Tensor, state: Tensor) -> Tensor:
        """Invert `to_model`."""
        absolute = chunk[..., : self.n_dims] * self.spread + self._position(state)[:, None]
        normalised = (absolute - self.action_shift) / self.action_scale
        return torch.cat([normalised, chunk[..., self.n_dims :]], dim=-1)

    def normalise_state(self, position: Tensor) -> Tensor:
        """Map physical positions ``(..., n_dims)`` to where LeRobot's normalisation of the state puts them."""
        return (position - self.state_shift) / self.state_scale

    def _displacement(self, actions: Tensor, state: Tensor) -> Tensor:
        absolute = self.action_scale * actions[..., : self.n_dims] + self.action_shift
        return absolute - self._position(state)[:, None]

    def _position(self, state: Tensor) -> Tensor:
        return self.state_scale * state[..., : self.n_dims] + self.state_shift
