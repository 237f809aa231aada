"""The windows that LeRobot delivers, and other hands in them.

A sample of a training is a window around a frame of a recording. With the target's path, that
recording also says what another hand would have seen:

    transplant  the view of the true target from another palm, plus the error that the camera made
                in that very frame, or, if the target was elsewhere in its image, in the frame of
                the window that looks most alike
    hands       that the policy itself leads through the window

A policy soon finds itself elsewhere than the hand that was recorded, so most windows show such
hands. Training only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from lerobot.utils.constants import ACTION
from torch import Tensor

from .camera import Pinhole
from .dataset import TargetTable
from .frames import Frames, Record, gather_frames
from .network import Batch, ObActModel, rolled_out
from .teacher import Targets, Teacher

UNITS = (0.25, 0.25, 0.3)
"""Differences in (u, v, log depth) that count as one when frames are compared. What is less than
one apart looks alike to the eye: as large, and at about the same place in the image."""
VIEW_LIMIT = 2.0  # |u| and |v| are cut to this: how far out of view a target is does not matter
IN_VIEW = 1.05  # greatest |u| and |v| of a target that is at least partly in view
DEPTH_POWER, DEPTH_RATIOS = 0.8, (0.5, 2.0)
"""Errors of the log depth grow with this power of the distance, and are scaled within these ratios
when they are taken from one distance to another: 8 % at 0.25 m and 22 % at 0.7 m were measured."""

START_M, START_POWER = 0.15, 3.0
"""How far from the recorded hand a virtual one starts: the greatest standard deviation along each
axis [m], drawn as this power of a uniform number, so that most start near it."""


@dataclass(frozen=True)
class Window(Record):
    """B windows of L frames; frames are counted from the window's first."""

    frames: Frames
    recorded: Tensor  # whether a frame was recorded, or LeRobot repeated one instead, (B, L)
    # recorded from the current frame on, or, with targets, from when inference has ended, (B, H, A)
    actions: Tensor
    action_weight: Tensor  # of those, 0 for padding, (B, H)
    begin: Tensor  # the frame in which the hand may move, (B,)
    delay_frames: int  # from a frame until the command that is decided in it takes effect
    targets: Targets | None = None  # None if nothing is known of them

    @property
    def n_frames(self) -> int:
        """Frames of each window, L."""
        return self.recorded.shape[1]

    @classmethod
    def of(
        cls, batch: Batch, model: ObActModel, table: TargetTable | None, inference_delay: int = 0
    ) -> Window:
        """Return the windows of a preprocessed batch, with the targets in them, if these are known
        of the dataset, while inference takes ``inference_delay`` frames.
        """
        # LeRobot delivers vectors of one entry as scalars
        actions = batch[ACTION].reshape(*batch[ACTION].shape[:2], -1)
        frames, recorded = _frames(batch, model)
        unpadded = torch.zeros(actions.shape[:2], dtype=torch.bool, device=actions.device)
        weight = (~batch.get(f"{ACTION}_is_pad", unpadded)).float()
        begin = torch.zeros(len(actions), dtype=torch.long, device=actions.device)
        delay_frames = model.config.embodiment.delay_frames + inference_delay
        window = cls(frames, recorded, actions, weight, begin, delay_frames)
        if table is None:
            return window
        # what is decided in a frame is commanded after inference: recorded commands of that time
        horizon = actions.shape[1]
        commanded = torch.arange(horizon, device=actions.device) + inference_delay
        loaded = commanded.clamp_max(horizon - 1)
        actions, weight = actions[:, loaded], weight[:, loaded] * (commanded < horizon)
        episode = batch["episode_index"].flatten().cpu()
        newest = batch["index"].flatten().cpu() - table.first_index[episode]
        offsets = model.config.observation_delta_indices
        targets, begin = table.window(episode, newest, offsets, delay_frames)
        window = replace(
            window, actions=actions, action_weight=weight, begin=begin, targets=targets
        )
        return window.to(actions.device)

    def repeated(self, n: int) -> Window:
        """Return each window n times in succession."""
        index = torch.arange(len(self.begin), device=self.begin.device)
        return self[index.repeat_interleave(n)]


def _frames(batch: Batch, model: ObActModel) -> tuple[Frames, Tensor]:
    """Return the frames of a batch, and which of them were recorded, ``(B, L)``."""
    config = model.config
    columns = config.sighting_keys
    if columns[0] in batch:
        observed = columns[0]
        sightings = torch.stack([batch[key] for key in columns], dim=2)
    else:
        observed = config.cameras[0]
        images = {key: batch[key] for key in config.cameras}
        before = {key: torch.cat([x[:, :1], x[:, :-1]], dim=1) for key, x in images.items()}
        sightings = model.encode_images(images, before)
    offsets = torch.tensor(config.observation_delta_indices, device=sightings.device)
    all_frames = torch.zeros(sightings.shape[:2], dtype=torch.bool, device=sightings.device)
    recorded = ~batch.get(f"{observed}_is_pad", all_frames)
    hidden = ~recorded & (offsets <= 0)
    state = model.state_of(batch, sightings.shape[:2])
    return Frames(sightings, state, offsets / config.embodiment.fps, hidden), recorded


class VirtualHands:
    """Draws hands for windows with targets.

    Args:
        teacher: knows what a catch is.
        model: leads hands, and knows the cameras.
    """

    def __init__(self, teacher: Teacher, model: ObActModel) -> None:
        self.teacher = teacher
        self.model = model

    @torch.no_grad()
    def drawn(self, window: Window, virtual_share: float) -> Window:
        """Return the windows with hands of which about ``virtual_share`` are virtual, unless they
        hold the target already.
        """
        targets = window.targets
        assert targets is not None
        gripped = targets.gripped
        led = (torch.rand(gripped.shape, device=gripped.device) < virtual_share) & ~gripped
        errors = RecordedErrors(window, self.model.forecaster.cameras)
        shown = self._with_state(window, errors, self._states(window, errors, led))
        catch = torch.where(led, self._catch(shown), targets.catch)
        return replace(shown, targets=replace(targets, catch=catch))

    def _catch(self, window: Window) -> Tensor:
        """Return the frames in which hands have caught their targets, ``(B,)``; of those that do
        not, the one after the last that is known.
        """
        targets = window.targets
        state = window.frames.state
        assert targets is not None
        frame = torch.arange(state.shape[1] - 1, device=state.device)
        offsets = window.frames.palm - targets.path[:, : state.shape[1]]
        caught = self.teacher.caught(offsets, state[..., 3:])
        caught &= frame >= window.begin[:, None]
        first = torch.where(caught, frame + 1, targets.length[:, None])
        return torch.cat([first, targets.length[:, None]], dim=1).amin(1)

    def _states(self, window: Window, errors: RecordedErrors, led: Tensor) -> Tensor:
        """Return the states of the hands, ``(B, L, S)``: recorded, or led by what they would have
        seen along the recorded way.
        """
        n = window.n_frames
        delay = window.delay_frames
        device = window.begin.device
        states = window.frames.state.clone()
        # a hand that still waits is at home
        elsewhere = (led & (window.begin <= 0))[:, None, None]
        spread_m = START_M * torch.rand(len(states), 1, 1, device=device) ** START_POWER
        states[..., :3] += elsewhere * spread_m * torch.randn(len(states), 1, 3, device=device)
        seen = self._with_state(window, errors, states).frames[led]
        decided_at = torch.arange(max(0, n - 1 - delay), device=device)
        decided_at = decided_at.expand(len(seen.state), -1)
        forecast = self.model.encode_history(seen, decided_at).later(delay)
        moves = (window.begin - delay)[led]  # the decision whose command first moves the hand
        states[led] = rolled_out(self.model, forecast, states[led, : delay + 1], begin=moves)
        return states

    def _with_state(self, window: Window, errors: RecordedErrors, state: Tensor) -> Window:
        """Return what hands would have seen in states ``(B, L, S)``."""
        assert window.targets is not None
        seen = errors.seen(window.targets.path[:, : state.shape[1]], state[..., :3])
        return replace(window, frames=replace(window.frames, sightings=seen, state=state))


class RecordedErrors:
    """Takes errors that cameras made in recorded frames to what other palms would have seen.

    Args:
        window: as recorded.
        cameras: one for each sighting of a frame.
    """

    def __init__(self, window: Window, cameras: list[Pinhole]) -> None:
        targets = window.targets
        recorded = window.recorded
        n = window.n_frames
        assert targets is not None
        row = torch.arange(n, device=recorded.device)
        usable = recorded & ((row < targets.catch[:, None]) | targets.gripped[:, None])
        # a window after the catch has none: one must do, though it may show something else
        usable[:, 0] |= ~usable.any(1)
        self.usable = usable
        self.cameras = cameras
        self.seen_there = window.frames.sightings
        self.true_there = _views(cameras, targets.path[:, :n], window.frames.palm)
        last = torch.where(usable, row, -1).amax(1, keepdim=True)
        first = torch.where(usable, row, n).amin(1, keepdim=True)
        # of which frame each one would take the error: its own, or, if it was not recorded, that of
        # one before, mirrored in time
        self.preferred = torch.where(row > last, 2 * last - row, row).maximum(first)

    def seen(self, place: Tensor, palm: Tensor) -> Tensor:
        """Return sightings ``(B, L, C, 5)`` of targets at ``place`` from palms at ``palm``, ``(B,
        L, 3)`` [m] both.
        """
        view = _views(self.cameras, place, palm)
        found = [
            self._with_errors(view[:, :, i], self.true_there[:, :, i], self.seen_there[:, :, i])
            for i in range(len(self.cameras))
        ]
        return torch.stack(found, dim=2)

    def _with_errors(self, view: Tensor, was: Tensor, seen: Tensor) -> Tensor:
        """Return what one camera sees, ``(B, L, 5)``, whose true view is ``(B, L, 3)``."""
        source = self._nearest(view, was)
        seen = gather_frames(seen, source)
        was = gather_frames(was, source)
        error = seen[..., :3] - was
        farther = ((view - was)[..., 2:] * DEPTH_POWER).exp().clamp(*DEPTH_RATIOS)
        error = torch.cat([error[..., :2], error[..., 2:] * farther], dim=-1)
        moved = torch.cat([view + error, seen[..., 3:]], dim=-1)
        # a target out of view has no error: what was seen then was something else, and still is
        return torch.where((was[..., :2].abs().amax(-1) < IN_VIEW)[..., None], moved, seen)

    def _nearest(self, view: Tensor, was: Tensor) -> Tensor:
        """Return of which frame of the window to take the error, ``(B, L)``: the preferred one, if
        it looked alike (less than one apart in `UNITS`), else the one that looked most alike.
        """
        apart = torch.cdist(_in_units(view), _in_units(was))  # (B, L, L)
        apart = apart.masked_fill(~self.usable[:, None], torch.inf)
        to_preferred = apart.gather(2, self.preferred[..., None])[..., 0]
        return torch.where(to_preferred < 1, self.preferred, apart.argmin(-1))


def _views(cameras: list[Pinhole], place: Tensor, palm: Tensor) -> Tensor:
    """Return ``(u, v, log depth)`` by camera, ``(B, L, C, 3)``, of places seen from palms ``(B, L,
    3)`` [m].
    """
    return torch.stack([camera.project(place - camera.origin(palm)) for camera in cameras], dim=2)


def _in_units(view: Tensor) -> Tensor:
    cut = view[..., :2].clamp(-VIEW_LIMIT, VIEW_LIMIT)
    return torch.cat([cut, view[..., 2:]], dim=-1) / view.new_tensor(UNITS)
