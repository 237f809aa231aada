"""Acting: from a stream of observations to executed actions."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import cast

import torch
from torch import Tensor

from .action_frame import ActionFrame
from .configuration_tracker import TrackerConfig
from .correction import Expectation, corrected_path
from .decisions import window_decisions
from .frames import EncodedFrames
from .heads.base import ActionHead, Condition, ForecastHead, Guide, Prefix
from .history import ChunkQueue, History
from .model import TrackerModel
from .observation import Batch, Observation
from .replan import indicator


class ChunkPlanner:
    """Remembers observed frames, predicts chunks of actions and executes them one action at a time.

    The network is an argument of every method: acting uses the averaged weights where there are any.

    Args:
        config: the policy's config.
        frame: the frame in which actions are predicted.
    """

    def __init__(self, config: TrackerConfig, frame: ActionFrame) -> None:
        self.config, self.frame = config, frame
        self.history, self.queue = History(config.windows), ChunkQueue()
        self._last_images: Tensor | None = None
        self.expectation: Expectation | None = None
        self._given: deque[Tensor] = deque(maxlen=config.latency_frames)

    def reset(self) -> None:
        """Forget the last episode."""
        self.history.clear()
        self.queue.clear()
        self._given.clear()
        self.expectation = None
        self._last_images = None

    def next_action(self, model: TrackerModel, batch: Batch, noise: Tensor | None = None) -> Tensor:
        """Return the next action of every environment, normalised, shape ``(B, A)``.

        Args:
            model: the network.
            batch: preprocessed observation of one control step; each call adds one frame to the history.
            noise: start of the chunks predicted in this step, shape ``(B, H, noise_dim)``; None draws it.
        """
        return self.advance(model, self.observe(batch), batch, noise)

    def observe(self, batch: Batch) -> Observation:
        """Read a preprocessed batch; single frames are put beside the ones before, if the config says so."""
        observation = Observation.from_batch(batch, self.config)
        if not self.config.motion or observation.images.shape[1] > 1:
            return observation
        before, self._last_images = self._last_images, observation.images
        return observation.after(observation.images if before is None else before)

    def note(self, batch: Batch) -> None:
        """Add one frame per environment to the history."""
        self.history.append(self.observe(batch))

    def advance(
        self, model: TrackerModel, frame: Observation | EncodedFrames, batch: Batch, noise: Tensor | None = None
    ) -> Tensor:
        """Return the next action after a frame, which may have been encoded already; see `next_action`.

        Args:
            model: the network.
            frame: one frame per environment, which joins the history.
            batch: what it was read from, for its ``config.replan_key``.
            noise: see `next_action`.
        """
        self.history.append(frame)
        n_rows = len(frame.keep)
        rows = self.queue.rows_to_plan(indicator(batch, self.config, n_rows), n_rows)
        if rows:
            start = self.noise(model, [self.queue.n_planned[row] for row in rows]) if noise is None else noise[rows]
            window = self.history.window(model.encode).rows(rows)
            prefix = self._given_prefix(window, rows) if model.head.accepts_prefix else None
            chunks = self.plan(model, window, start, prefix=prefix)
            self.queue.put(rows, chunks[:, self.config.latency_frames :][:, : self.config.n_action_steps])
        action = self.queue.pop()
        self._remember(action, frame)
        return action

    def window(self, model: TrackerModel, batch: Batch) -> EncodedFrames:
        """Return the encoded frames that a decision sees, shape ``(B, s + 1)``.

        Args:
            model: the network.
            batch: one frame per environment, which joins the history, or the frames of a dataset sample.

        Raises:
            ValueError: if the batch has another number of frames.
        """
        observation, windows = self.observe(batch), self.config.windows
        n_frames = observation.keep.shape[1]
        if n_frames == len(windows.lookback):
            return model.encode(observation)
        if n_frames == len(windows.observation_offsets):
            return model.encode(observation.frames(windows.frame_index[0]))
        if n_frames == 1:
            self.history.append(observation)
            return self.history.window(model.encode)
        raise ValueError(
            f"the batch has {n_frames} frames per sample, but must have 1 or "
            f"{len(windows.observation_offsets)}: those at {windows.observation_offsets}."
        )

    def plan(
        self,
        model: TrackerModel,
        window: EncodedFrames,
        noise: Tensor,
        guide: Guide | None = None,
        prefix: Prefix | None = None,
    ) -> Tensor:
        """Return one normalised chunk per row of the window, shape ``(B, H, A)``.

        Args:
            model: the network.
            window: encoded frames, oldest first.
            noise: start of the sampling, shape ``(B, H, noise_dim)``.
            guide: steers the sampling, for heads with ``accepts_guide``.
            prefix: see `Condition`; a chunk of a head with ``accepts_prefix`` begins with it.
        """
        whole_window = [list(range(window.keep.shape[1]))]
        decisions = window_decisions(window, whole_window, self.config)
        condition = replace(model.conditions(window, decisions), prefix=prefix)
        return self.frame.to_actions(self._sample(model.head, condition, noise, guide), condition.position)

    def _sample(self, head: ActionHead, condition: Condition, noise: Tensor, guide: Guide | None) -> Tensor:
        """Sample chunks, and keep what they were planned for."""
        if not isinstance(head, ForecastHead):
            return head.sample(condition, noise, guide)
        forecast = head.forecast(condition)
        self.expectation = Expectation(head.path(forecast) + condition.position[:, None, :3], forecast.closed)
        return head.chunk(forecast, condition)

    def corrected(self, model: TrackerModel, rows: list[int], expectation: Expectation, age: Tensor) -> Tensor:
        """Return the normalised actions ``(R, A)`` of some environments, for what was seen since a chunk was planned.

        Args:
            model: the network.
            rows: which environments.
            expectation: what their chunks were planned for.
            age: frames since the observation that each was planned from, shape ``(R,)``.
        """
        frames = self.history.latest(int(age.max()) + 1, model.encode).rows(rows)
        head, here = cast(ForecastHead, model.head), frames.position[:, -1]
        path = corrected_path(expectation.path, model.sightings(frames), age, self.config.fps) - here[:, None, :3]
        start = self.frame.to_model(self._here(frames), here)[:, 0]
        return self.frame.to_actions(head.moves(path, expectation.closed, start, 1), here)[:, 0]

    def noise(self, model: TrackerModel, chunk_numbers: list[int]) -> Tensor:
        """Draw the noise that one chunk per row starts from, shape ``(R, H, noise_dim)``.

        Args:
            model: the network, for the size of the noise and its device.
            chunk_numbers: chunks predicted before in each row's episode; with a seed the noise depends on them alone.
        """
        shape, device = (self.config.horizon, model.head.noise_dim), next(model.parameters()).device
        if self.config.noise_seed is None:
            return torch.randn(len(chunk_numbers), *shape, device=device) * self.config.noise_scale
        seeds = [self.config.noise_seed + 1_000_003 * number for number in chunk_numbers]
        draws = [torch.randn(shape, generator=torch.Generator().manual_seed(seed)) for seed in seeds]
        return torch.stack(draws).to(device) * self.config.noise_scale

    def prefix(self, window: EncodedFrames, leftover: Tensor | None, length: Tensor) -> Prefix:
        """Return what hands execute while their chunks are planned.

        Args:
            window: encoded frames, the current one last.
            leftover: normalised actions from the current frame on, the last of which is repeated if they are too few,
                shape ``(B, n, A)``; None if the hands stay where they are.
            length: how many are executed, shape ``(B,)``. Nothing is executed in the observation window.
        """
        here = self._here(window)
        n_steps = int(length.max())
        actions = here.expand(-1, n_steps, -1)
        if leftover is not None:
            index = torch.arange(n_steps, device=leftover.device).clamp_max(leftover.shape[1] - 1)
            actions = torch.where(window.watching[:, -1:, None], actions, leftover[:, index])
        return Prefix(self.frame.to_model(actions, window.position[:, -1]), length)

    def _given_prefix(self, window: EncodedFrames, rows: list[int]) -> Prefix:
        """Return the commands that have been given and have not taken effect; before the first the hand stays."""
        late = self.config.latency_frames
        given = [action[rows, None].to(window.position.device) for action in self._given]
        actions = torch.cat([self._here(window).expand(-1, late - len(given), -1), *given], dim=1)
        length = torch.full((len(rows),), late, device=actions.device)
        return Prefix(self.frame.to_model(actions, window.position[:, -1]), length)

    def _here(self, window: EncodedFrames) -> Tensor:
        return window.position[:, -1:, : self.config.action_dim]  # (B, 1, A)

    def _remember(self, action: Tensor, frame: Observation | EncodedFrames) -> None:
        """Keep a command; one that is given in the observation window is void, so the hand stays where it is."""
        if self.config.latency_frames:
            here = frame.position[:, -1, : action.shape[-1]].cpu()
            self._given.append(torch.where(frame.watching[:, -1:].cpu(), here, action.cpu()))
