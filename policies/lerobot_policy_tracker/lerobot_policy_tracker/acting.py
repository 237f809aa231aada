"""How a tracker policy acts: an action at a time, or a chunk, with real-time chunking."""

from __future__ import annotations

from typing import Any

import torch
from lerobot.policies.rtc import RTCProcessor
from torch import Tensor, nn

from .action_frame import ActionFrame
from .configuration_tracker import TrackerConfig
from .correction import Expectation
from .frames import EncodedFrames
from .heads.base import ForecastHead, Guide
from .model import TrackerModel
from .observation import Batch, Observation
from .planner import ChunkPlanner
from .rtc import rtc_guide


class ChunkActing(nn.Module):
    """The half of an `TrackerPolicy` that plans and acts; its weights, `_active_model`, are the policy's."""

    config: TrackerConfig
    frame: ActionFrame
    model: TrackerModel
    planner: ChunkPlanner
    rtc_processor: RTCProcessor | None
    _active_model: TrackerModel

    def reset(self) -> None:
        """Forget the last episode."""
        self.planner.reset()

    @torch.no_grad()
    def select_action(self, batch: Batch, noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Return the next action of every environment, normalised, shape ``(B, A)``.

        Call it once per control step: each call adds one frame to the history. An environment replans when its chunk
        is used up, and when its ``replan_key`` rises: a chunk predicted during the observation window is outdated once
        the hand may move.

        Args:
            batch: preprocessed observation of one step.
            noise: start of the chunks predicted in this step, shape ``(B, H, noise_dim)``; None draws it as
                ``noise_seed`` says.
            **kwargs: unused.
        """
        self.eval()
        return self.planner.next_action(self._active_model, batch, noise)

    def select_action_after(self, frame: Observation, looks: Tensor, batch: Batch) -> Tensor:
        """Return the next action as `select_action` does, of a frame whose images have been looked at.

        Args:
            frame: the observation of one control step.
            looks: what the model's `look` returned for it.
            batch: what it was read from.
        """
        model = self._active_model
        return self.planner.advance(model, self.encode_looks(frame, looks), batch)

    def encode_looks(self, frame: Observation, looks: Tensor) -> EncodedFrames:
        """Encode a frame whose images have been looked at, see `TrackerModel.encode_looks`."""
        return self._active_model.encode_looks(frame, looks)

    def plan_after(self, rows: list[int], leftover: Tensor | None, length: Tensor) -> Tensor:
        """Return normalised chunks ``(R, D + H, A)`` of some environments, from the frames that were noted.

        Args:
            rows: which environments.
            leftover, length: what each executes meanwhile, see `ChunkPlanner.prefix`; D is the greatest length.
        """
        model = self._active_model
        window = self.planner.history.window(model.encode).rows(rows)
        prefix = self.planner.prefix(window, leftover, length)
        return self.planner.plan(model, window, self.planner.noise(model, [0] * len(rows)), prefix=prefix)

    @torch.no_grad()
    def observe(self, batch: Batch) -> None:
        """Add one frame per environment to the history without acting, for callers that ask for chunks now and then."""
        self.planner.note(batch)

    @torch.no_grad()
    def predict_action_chunk(
        self,
        batch: Batch,
        noise: Tensor | None = None,
        inference_delay: int | None = None,
        prev_chunk_left_over: Tensor | None = None,
        execution_horizon: int | None = None,
    ) -> Tensor:
        """Return a whole chunk, normalised, shape ``(B, H, A)``.

        A head with ``accepts_prefix`` plans from where the hand will be after the actions that are executed meanwhile,
        and puts those first: ``(B, D + H, A)``.

        Args:
            batch: one frame per environment, which joins the history, or a dataset batch with a time axis.
            noise: start of the sampling, shape ``(B, H, noise_dim)``; None draws it as ``noise_seed`` says.
            inference_delay: real-time chunking: actions that will have been executed when this chunk is ready.
            prev_chunk_left_over: real-time chunking: unexecuted normalised actions, shape ``(B, n, A)`` or ``(n, A)``.
            execution_horizon: real-time chunking: actions over which the guidance to the old chunk fades out.

        Raises:
            ValueError: if the batch has the wrong number of frames.
        """
        self.eval()
        model = self._active_model
        window = self.planner.window(model, batch)
        start = self.planner.noise(model, [0] * len(window.keep)) if noise is None else noise
        if self.accepts_prefix and inference_delay is not None:
            length = torch.full((len(window.keep),), inference_delay, device=window.position.device)
            leftover = prev_chunk_left_over
            leftover = None if leftover is None else leftover.reshape(len(length), -1, leftover.shape[-1])
            return self.planner.plan(model, window, start, prefix=self.planner.prefix(window, leftover, length))
        guide = self._guide(window, prev_chunk_left_over, inference_delay or 0, execution_horizon)
        return self.planner.plan(model, window, start, guide)

    @property
    def accepts_prefix(self) -> bool:
        """Whether a chunk continues the actions that are executed while it is planned, without any guidance."""
        return self._active_model.head.accepts_prefix

    @property
    def corrects(self) -> bool:
        """Whether a chunk can be corrected in every frame for where the target is seen, see `correction.py`.

        Not where commands take effect late: those that are on their way are not known then.
        """
        return isinstance(self._active_model.head, ForecastHead) and not self.config.latency_frames

    def expectations(self, rows: list[int]) -> list[Expectation]:
        """Return what the last chunks of some environments were planned for, one row each; the policy ``corrects``."""
        assert self.planner.expectation is not None, "no chunk has been planned"
        return [self.planner.expectation.rows([row]) for row in rows]

    @torch.no_grad()
    def corrected_action(self, rows: list[int], expectations: list[Expectation], age: list[int]) -> Tensor:
        """Return the actions of the newest frame in place of those of a chunk, normalised, shape ``(R, A)``.

        Args:
            rows: which environments, ``R`` of them.
            expectations: what the chunk that each executes was planned for, one row each.
            age: frames since the observation that it was planned from.
        """
        stacked = Expectation.concatenate(expectations)
        ages = torch.tensor(age, device=stacked.path.device)
        return self.planner.corrected(self._active_model, rows, stacked, ages)

    def _guide(
        self, window: EncodedFrames, leftover: Tensor | None, inference_delay: int, execution_horizon: int | None
    ) -> Guide | None:
        """Return the guidance of real-time chunking towards the unexecuted actions, if there are any."""
        if self.rtc_processor is None or leftover is None:
            return None
        leftover = leftover.reshape(len(window.keep), -1, leftover.shape[-1])[:, : self.config.horizon]
        leftover = self.frame.to_model(leftover, window.position[:, -1])  # (B, n, A)
        return rtc_guide(self.rtc_processor, leftover, inference_delay, execution_horizon)

    def supports_rtc(self) -> bool:
        """Return whether `predict_action_chunk` honours real-time chunking: the head is a flow, or takes a prefix."""
        return self.model.head.accepts_guide or self.model.head.accepts_prefix

    def init_rtc_processor(self) -> None:
        """Build the guidance that ``config.rtc_config`` describes; `lerobot-rollout` calls this after setting it."""
        rtc = self.config.rtc_config
        self.rtc_processor = RTCProcessor(rtc) if rtc is not None and rtc.enabled else None
