"""The training objective: imitation of the executed actions, and an auxiliary loss on the visual encoder.

For the decisions of a batch that are ever executed, with the head's loss ``l`` of action ``h`` and dimension ``d``,
dimension weights ``w`` of mean 1, and the position ``p`` that the probe reads off the tokens of frame ``t``::

    L = mean over kept actions of mean_d(w_d l_hd)  +  privileged_weight * mean over kept frames of |p_t - target_t|
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from lerobot.utils.constants import ACTION
from torch import Tensor

from .action_frame import ActionFrame
from .configuration_tracker import TrackerConfig
from .decisions import Decisions, window_decisions
from .demonstrated import Demonstrated
from .finite import require_finite
from .frames import EncodedFrames
from .heads.base import Forecast
from .heads.intercept import PALM_DIM
from .model import TrackerModel
from .observation import Batch, Observation
from .replan import indicator, rise_threshold


@dataclass(frozen=True)
class ImitationLoss:
    """The loss of a batch before reduction.

    Attributes:
        error: weighted loss of every action of the wanted decisions, 0 where it is not learned from, shape ``(R, H)``.
        keep: actions that are learned from, shape ``(B, K, H)``.
        decisions: which decisions are wanted.
        privileged: weighted auxiliary loss of every sample, shape ``(B,)``.
    """

    error: Tensor
    keep: Tensor
    decisions: Decisions
    privileged: Tensor

    def mean(self) -> Tensor:
        """Return the loss averaged over all actions of the batch, a scalar."""
        return self.error.sum() / self.keep.sum().clamp_min(1) + self.privileged.mean()

    def per_sample(self) -> Tensor:
        """Return the loss averaged over the actions of each sample, shape ``(B,)``."""
        error = self.decisions.spread(self.error).flatten(1).sum(-1)  # (R, H) -> (B, K, H) -> (B,)
        return error / self.keep.flatten(1).sum(-1).clamp_min(1) + self.privileged


class ImitationObjective:
    """Computes the loss of a batch.

    Args:
        config: the policy's config.
        frame: the frame in which actions are predicted.
        labels: returns positions ``(B, T, P)`` in the unit of the state, given dataset indices ``(B,)`` and frame
            offsets; None trains on actions alone.
        forecasts: returns the labels of forecasts likewise, for heads that forecast.
    """

    def __init__(
        self,
        config: TrackerConfig,
        frame: ActionFrame,
        labels: Callable[[Tensor, list[int]], Tensor] | None,
        forecasts: Demonstrated | None = None,
    ) -> None:
        self.config, self.frame, self.labels, self.forecasts = config, frame, labels, forecasts
        self.set_dataset_stats(None)

    def set_dataset_stats(self, stats: dict[str, dict[str, Any]] | None) -> None:
        """Adopt the LeRobot statistics that batches are normalised with; None if they are unknown."""
        self._risen_from = rise_threshold(self.config, stats)

    def __call__(self, model: TrackerModel, batch: Batch, observation: Observation, training: bool) -> ImitationLoss:
        """Return the loss of a batch.

        Args:
            model: the network whose loss it is.
            batch: preprocessed LeRobot batch with the actions of ``config.action_delta_indices``.
            observation: its frames, those of ``config.observation_delta_indices``.
            training: whether the spread of the displacements may still be measured.

        Raises:
            FloatingPointError: if the loss is not finite.
        """
        frames = model.encode(observation)
        windows, actions = self.config.windows, batch[ACTION]
        chunk_index = torch.tensor(windows.action_index, device=actions.device)  # (K, H)
        keep = _kept_actions(batch)[:, chunk_index] & self._executed(batch)  # (B, L) -> (B, K, H)
        # If no action of the batch is kept, all are computed and masked: every weight needs a gradient, even if zero.
        wanted = keep.any(-1) | ~keep.any()  # (B, K)
        decisions = window_decisions(frames, windows.frame_index, self.config, wanted)

        chunks, kept = decisions.pick(actions[:, chunk_index]), decisions.pick(keep)  # (R, H, A), (R, H)
        if self.forecasts is not None:
            error = self._forecast_error(model, batch, frames, decisions)[:, None] * kept
        else:
            if training:
                self.frame.observe(chunks, decisions.current(frames.position), kept)
            error = self._chunk_error(model, chunks, frames, decisions) * kept  # (R, H)
        privileged = self.config.privileged_weight * self._privileged_error(model, batch, frames)  # (B,)
        require_finite({"action": error, "privileged": privileged}, batch)
        return ImitationLoss(error, keep, decisions, privileged)

    def _forecast_error(self, model: TrackerModel, batch: Batch, frames: EncodedFrames, decisions: Decisions) -> Tensor:
        """Return the loss of the forecast at each wanted decision, shape ``(R,)``."""
        assert self.forecasts is not None
        labels = self.forecasts(batch["index"], self.config.windows.decision_moments)
        condition = model.conditions(frames, decisions)
        palm = condition.position[:, None, :PALM_DIM]
        label = Forecast(decisions.pick(labels.path) - palm, decisions.pick(labels.closed))
        return model.head.forecast_loss(label, condition, decisions.pick(labels.arrival), decisions.pick(labels.known))

    def _chunk_error(self, model: TrackerModel, chunks: Tensor, frames: EncodedFrames, decisions: Decisions) -> Tensor:
        """Return the head's loss of every action of the wanted chunks, ``(R, H, A) -> (R, H)``."""
        targets = self.frame.to_model(chunks, decisions.current(frames.position))
        losses = model.head.loss(targets, model.conditions(frames, decisions))  # (R, H, A)
        return (losses * self._dimension_weights(losses)).mean(-1)

    def _dimension_weights(self, losses: Tensor) -> Tensor:
        """Return the weight of each action dimension, ``(A,)`` with mean 1."""
        weights = losses.new_ones(losses.shape[-1])
        weights[: self.frame.n_dims] = self.config.relative_weight
        return weights / weights.mean()

    def _executed(self, batch: Batch) -> Tensor:
        """Return which decisions are ever executed, ``(B, K, 1)``: those after the rise of ``replan_key``."""
        loaded = self.config.observation_delta_indices
        value = indicator(batch, self.config, len(batch[ACTION]), len(loaded))  # (B, T)
        if value is None:
            return torch.ones(1, 1, 1, dtype=torch.bool, device=batch[ACTION].device)
        moments = [loaded.index(moment) for moment in self.config.windows.decision_moments]
        return value[:, moments, None] >= self._risen_from

    def _privileged_error(self, model: TrackerModel, batch: Batch, frames: EncodedFrames) -> Tensor:
        """Return the probe's mean absolute error per sample, in units of the normalised state, ``(B,)``."""
        if self.labels is None or model.probe is None:
            return torch.zeros_like(frames.keep[:, 0], dtype=frames.tokens.dtype)
        target = self.labels(batch["index"], self.config.windows.observation_offsets)  # (B, T, P)
        offset = self.frame.normalise_state(target) - frames.position[..., : target.shape[-1]]
        error = (model.probe(frames.tokens) - offset).abs().mean(-1)  # (B, T)
        return (error * frames.keep).sum(-1) / frames.keep.sum(-1).clamp_min(1)


def _kept_actions(batch: Batch) -> Tensor:
    pad = batch.get(f"{ACTION}_is_pad")
    return torch.ones_like(batch[ACTION][..., 0], dtype=torch.bool) if pad is None else ~pad.bool()  # (B, L)
