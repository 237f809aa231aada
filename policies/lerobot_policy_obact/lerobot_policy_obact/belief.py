"""Belief: what the frames observed so far say about where the target is and where it will be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Self, cast

import torch
from einops import einsum, rearrange, repeat
from torch import Tensor, nn

from .attention import Memory, PositionReadout, TemporalBlock
from .camera import Pinhole
from .configuration_obact import ObActConfig
from .encoders import N_SIGHTING
from .heads import perceptron

FORECAST_FRAMES = (0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48)
"""Frames ahead at which the target's position is forecast."""
PLACE_M, RAY_M, POINT_M = 0.3, 0.4, 0.1
"""Units in which places, their offsets from the camera and differences between points enter the
network."""
FAR = 8.0  # inputs are cut to this many units
UNCALIBRATED = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""Calibration, see `Rig`, of a camera that sees rays of unit depth from the origin."""


@dataclass(frozen=True)
class Record:
    """Tensors, and records of those, by name."""

    def map(self, change: Callable[[Any], Any]) -> Self:
        """Return it with all that it holds changed."""
        held = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: change(x) for name, x in held.items() if x is not None})

    def to(self, device: str | torch.device) -> Self:
        """Return it with all that it holds on a device."""
        return self.map(lambda x: x.to(device))

    def __getitem__(self, index: Any) -> Self:
        """Return it with all that it holds indexed, where all tensors begin with the same axes."""
        return self.map(lambda x: x[index])


@dataclass(frozen=True)
class Frames(Record):
    """T frames of B episodes, in the order of time."""

    # by camera (u, v, log depth) and two log scales, then the embedding, (B, T, C, 5 + E)
    sightings: Tensor
    state: Tensor  # of the robot, (B, T, S)
    time_s: Tensor  # when they were seen [s], (T,)

    @property
    def palm(self) -> Tensor:
        """Where the palm is [m], ``(B, T, 3)``."""
        return palm_of(self.state)

    def remembered(self, memory: Memory) -> Frames:
        """Return these frames after those before, which ``memory`` keeps, as it does these."""
        sightings, state = (
            memory.extended("sightings", self.sightings),
            memory.extended("state", self.state),
        )
        return Frames(sightings, state, memory.extended("times", self.time_s[None])[0])

    def windows(self, rows: Tensor, ages_s: Tensor) -> Frames:
        """Return the frames of given ages ``(W,)`` [s] as seen from frames ``rows`` ``(B, Q)``, of
        ``(B * Q, W)``.

        For each age that is the frame nearest to it; before the first frame stands the first.
        Frames of all rows are as far apart as those of the first row.
        """
        wanted = self.time_s[rows][..., None] - ages_s  # (B, Q, W)
        middles = (self.time_s[1:] + self.time_s[:-1]) / 2
        index = torch.searchsorted(middles, wanted.contiguous(), right=True)
        sightings, state = (
            gather_frames(x, index).flatten(0, 1) for x in (self.sightings, self.state)
        )
        first, nearest_s = wanted[0, 0], self.time_s[index[0, 0]]
        return Frames(sightings, state, torch.where(first < self.time_s[0], first, nearest_s))


def gather_frames(table: Tensor, frame: Tensor) -> Tensor:
    """Return what tables ``(B, T, ...)`` hold for frames ``(B, Q...)``, ``(B, Q..., ...)``."""
    rows = torch.arange(len(frame), device=frame.device)
    return table[rows.view(-1, *[1] * (frame.dim() - 1)), frame]


def palm_of(state: Tensor) -> Tensor:
    """Return where palms are [m], ``(..., 3)``: the first entries of a state or action, as many as
    there are.
    """
    return nn.functional.pad(state[..., :3], (0, max(0, 3 - state.shape[-1])))


def stepped(palm: Tensor, goal: Tensor, step_m: float) -> Tensor:
    """Return where palms ``(..., 3)`` [m] are a frame later that go towards their goals, at most
    ``step_m`` far.
    """
    way = goal - palm
    return palm + way * (step_m / (way.square().sum(-1, keepdim=True) + 1e-10).sqrt()).clamp_max(
        1.0
    )


@dataclass(frozen=True)
class Outlook(Record):
    """What decisions, ``(B, Q)``, believe."""

    features: Tensor  # (B, Q, D)
    forecast: Tensor  # of the target [m], (B, Q, K, 3), see `FORECAST_FRAMES`
    weights: Tensor | None = (
        None  # of the S frames observed in the J positions read out, (B, Q, J, S)
    )


class Belief(nn.Module):
    """Tokens of frames, causal attention over them, and a forecast that combines positions sighted
    earlier.

    Args:
        config: with the rig filled in.
        n_extra: numbers of a token beside those of the sightings.
    """

    ahead_s: Tensor

    def __init__(self, config: ObActConfig, n_extra: int) -> None:
        super().__init__()
        dim, n_points, k = config.dim, config.n_points, len(FORECAST_FRAMES)
        known = [config.rig.calibration.get(key, UNCALIBRATED) for key in config.cameras]
        self.n_points = n_points
        cameras = nn.ModuleList(Pinhole.from_pose(x[:7], x[7], carried=bool(x[8])) for x in known)
        self.cameras = cast("list[Pinhole]", cameras)
        self.register_buffer(
            "ahead_s", torch.tensor(FORECAST_FRAMES) / config.rig.fps, persistent=False
        )
        self.token = perceptron(3 + 6 * len(known) + n_extra, dim, dim)
        self.blocks = nn.ModuleList(
            TemporalBlock(dim, config.n_heads) for _ in range(config.n_layers)
        )
        self.norm = nn.LayerNorm(dim)
        if n_points:
            self.readout = PositionReadout(dim, n_points)
            self.linear = nn.Linear(3 * n_points, 3 * k, bias=False)
            nn.init.zeros_(self.linear.weight)
        else:
            self.now = nn.Linear(dim, 3)
        last = nn.Linear(256, 3 * k)
        nn.init.zeros_(last.weight)
        self.bend = nn.Sequential(perceptron(dim + 3 * n_points, 256, 256), nn.SiLU(), last)

    def forward(self, frames: Frames, rows: Tensor, memory: Memory | None = None) -> Outlook:
        """Return what decisions at frames ``rows`` ``(B, Q)`` believe.

        ``memory`` is of the frames before these, which it also is to keep.
        """
        memory, time_s = memory or Memory(), frames.time_s
        (eyes, rays), scales = self.sighted(frames), frames.sightings[..., 3:N_SIGHTING]
        position = fused(eyes, rays, scales)
        origin = memory.first("origin", position[:, :1])
        extra = frames.sightings[..., N_SIGHTING:].flatten(2)
        seen = [
            scales.clamp(-6, 3) / 3,
            scales[..., :1].clamp_max(2).exp(),
            (rays / RAY_M).clamp(-FAR, FAR),
        ]
        place = ((position - origin) / PLACE_M).clamp(-FAR, FAR)
        tokens = self.token(torch.cat([place, torch.cat(seen, dim=-1).flatten(2), extra], dim=-1))
        age_s = time_s[:, None] - memory.extended("time", time_s[None])  # (T, S), negative ahead
        for block in self.blocks:
            tokens = block(tokens, age_s, memory)
        tokens = self.norm(tokens)
        chosen = repeat(rows, "b q -> b q d", d=tokens.shape[-1])
        features, points, weights = tokens.gather(1, chosen), None, None
        if self.n_points:
            points, weights = self.readout(tokens, position - origin, age_s, rows, memory)
        return Outlook(features, self._forecast(features, points) + origin[:, :, None], weights)

    def sighted(self, frames: Frames) -> tuple[Tensor, Tensor]:
        """Return where the cameras are, and where from there they see the target [m], ``(B, T, C,
        3)`` each.
        """
        eyes = [cam.origin(frames.palm) + cam.pos for cam in self.cameras]
        rays = [
            cam.place(frames.sightings[:, :, i, :3]) - cam.pos for i, cam in enumerate(self.cameras)
        ]
        return torch.stack(eyes, dim=2), torch.stack(rays, dim=2)

    def _forecast(self, decisions: Tensor, points: Tensor | None) -> Tensor:
        """Combine the positions read out, ``(B, Q, J, 3)``, linearly, and bend the result by what
        the tokens say.
        """
        if points is None:
            base, features = PLACE_M * self.now(decisions)[:, :, None], decisions
        else:
            anchor = points[:, :, :1]
            differences = rearrange((points - anchor) / POINT_M, "b q j i -> b q (j i)")
            base = anchor + POINT_M * rearrange(
                self.linear(differences), "b q (k i) -> b q k i", i=3
            )
            features = torch.cat([decisions, differences.clamp(-FAR, FAR)], dim=-1)
        bend = rearrange(self.bend(features), "b q (k i) -> b q k i", i=3)
        return base + bend * (0.03 + 0.5 * self.ahead_s)[:, None]


def fused(eyes: Tensor, rays: Tensor, scales: Tensor) -> Tensor:
    """Return where the cameras together place the target [m], ``(B, T, 3)``: each counts by what it
    is sure of.

    A camera's error is taken to be Gaussian with the ``scales`` ``(B, T, C, 2)`` it reports, across
    and along its line of sight, so the lines of sight of two cameras cross where both are precise.
    See `Belief.sighted` for the others.
    """
    if eyes.shape[2] == 1:
        return (eyes + rays)[:, :, 0]
    distance = rays.norm(dim=-1, keepdim=True).clamp_min(1e-3)
    sight = rays / distance
    across, along = ((scales.clamp(-6, 2).exp() * distance).clamp_min(1e-3) ** -2)[
        ..., None
    ].unbind(-2)  # (B, T, C, 1)
    line = einsum(sight, sight, "... i, ... j -> ... i j")
    precise = (
        across[..., None] * (torch.eye(3, device=line.device) - line) + along[..., None] * line
    )
    return torch.linalg.solve(precise.sum(2), (precise @ (eyes + rays)[..., None]).sum(2))[..., 0]
