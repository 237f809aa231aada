"""From the observation history to a forecast: where the target is seen, and where it will be.

sighted     places that each camera saw, in the frame of the state
fused       one place a frame: each camera counts by what it is sure of (`camera`)
tokens      of frames, with causal attention over them (`attention`)
readout     places sighted earlier, averaged by attention, and a forecast that combines these
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import torch
from einops import rearrange
from scipy.interpolate import CubicSpline
from torch import Tensor, nn

from .attention import PositionReadout, TemporalBlock, out_of_sight
from .camera import BLIND_LOG_ERROR, LOG_ERRORS, Pinhole, fused
from .configuration_obact import ObActConfig
from .encoders import N_SIGHTING
from .frames import Frames, Record, gather_frames
from .layers import perceptron

FORECAST_FRAMES = (0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48)
"""Frames ahead at which the target's position is forecast: every one at first, then about a third
farther each. Not tuned."""
_LAST = FORECAST_FRAMES[-1]
_FROM_LATER = np.arange(_LAST + 1)[:, None] + FORECAST_FRAMES
_SPLINE = CubicSpline(FORECAST_FRAMES, np.eye(len(FORECAST_FRAMES)))
LATER = torch.from_numpy(_SPLINE(_FROM_LATER.clip(max=_LAST)))
"""Weights of a forecast's places in the same forecast from n frames later, ``(N, K, K)``. Straight
lines between its times would be 4 cm off half a second into a fall."""
PLACE_M = 0.3
RAY_M = 0.4
POINT_M = 0.1
"""Units in which places, their offsets from the camera and differences between points enter the
network: about their standard deviations."""
MOST_UNITS = 8.0  # inputs are cut to this many units: what is farther off is an error of the eye
LOG_ERROR_UNIT = 3.0  # in which log scales of a sighting enter the network
BEND_WIDTH = 256
"""Width of the hidden layers of the network's correction of the forecast, whatever
`ObActConfig.width`, that of what the head reads, is. Not tuned."""
UNCALIBRATED = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""Calibration, see `Embodiment`, of a camera that sees rays of unit depth from the origin."""


@dataclass(frozen=True)
class GrowingUnit:
    """A unit of lengths that grows with the time ahead: what lies farther ahead is known less
    well.
    """

    now_m: float
    per_s: float  # by how much it is more for every second ahead [m/s]

    def at(self, ahead_s: Tensor) -> Tensor:
        """Return the unit at times ``(K,)`` [s], ``(K,)`` [m]."""
        return self.now_m + self.per_s * ahead_s


BEND = GrowingUnit(0.03, 0.5)
"""Unit of the network's correction of the forecast: at first about the eye's error, then half a
meter more for every second. Not tuned."""


@dataclass(frozen=True)
class Forecast(Record):
    """Where decisions, ``(B, Q)``, expect the target."""

    features: Tensor  # (B, Q, D)
    places: Tensor  # of the target [m], (B, Q, K, 3), see `FORECAST_FRAMES`
    attention: Tensor  # weights of the T frames of the history in J readouts, (B, Q, J, T)

    def later(self, frames: int | Tensor) -> Forecast:
        """Return the forecast shifted by ``frames``, one number or ``(B, Q)``: its first place is
        the one that this forecast expects so many frames ahead.
        """
        weights = LATER.to(self.places)[torch.as_tensor(frames).clamp_max(len(LATER) - 1)]
        return replace(self, places=weights @ self.places)


class Forecaster(nn.Module):
    """Tokens of frames, causal attention over them, and a forecast that combines positions sighted
    earlier.

    Args:
        config: with the embodiment filled in.
        n_extra: numbers of a token beside those of the sightings.
    """

    ahead_s: Tensor

    def __init__(self, config: ObActConfig, n_extra: int) -> None:
        super().__init__()
        dim = config.dim
        n_ahead = len(FORECAST_FRAMES)
        cameras = nn.ModuleList(
            Pinhole.from_pose(pose, half_view, carried=bool(carried))
            for *pose, half_view, carried in (
                config.embodiment.calibration.get(key, UNCALIBRATED) for key in config.cameras
            )
        )
        self.cameras = cast("list[Pinhole]", cameras)
        ahead_s = torch.tensor(FORECAST_FRAMES) / config.embodiment.fps
        self.register_buffer("ahead_s", ahead_s, persistent=False)
        self.token = perceptron(3 + 6 * len(cameras) + n_extra, dim, dim)
        self.blocks = nn.ModuleList(
            TemporalBlock(dim, config.n_heads) for _ in range(config.n_layers)
        )
        self.norm = nn.LayerNorm(dim)
        self.readout = PositionReadout(dim, config.n_points)
        self.linear = nn.Linear(3 * config.n_points, 3 * n_ahead, bias=False)
        nn.init.zeros_(self.linear.weight)
        bend = nn.Linear(BEND_WIDTH, 3 * n_ahead)
        nn.init.zeros_(bend.weight)
        read = perceptron(dim + 3 * config.n_points, BEND_WIDTH, BEND_WIDTH)
        self.bend = nn.Sequential(read, nn.SiLU(), bend)

    def forward(self, frames: Frames, decided_at: Tensor) -> Forecast:
        """Return the forecast of decisions at frames ``decided_at`` ``(B, Q)``, each from the
        frames up to its own.
        """
        centers, rays = self.sighted(frames)
        position = fused(centers, rays, frames.sightings[..., 3:N_SIGHTING])
        # in the oldest frame of the history or window; positions are relative to this one
        first = gather_frames(position, frames.hidden.int().argmin(1)[:, None])
        tokens = self.token(_inputs(frames.sightings, rays, position - first))
        age_s = frames.time_s[:, None] - frames.time_s  # (T, T), negative ahead
        unseen = out_of_sight(age_s, frames.hidden)
        for block in self.blocks:
            tokens = block(tokens, age_s, unseen)
        tokens = self.norm(tokens)
        features = gather_frames(tokens, decided_at)
        points, attention = self.readout(tokens, position - first, age_s, unseen, decided_at)
        places = self._places(features, points) + first[:, :, None]
        return Forecast(features, places, attention)

    def sighted(self, frames: Frames) -> tuple[Tensor, Tensor]:
        """Return where the cameras are, and where from there they see the target [m], ``(B, T, C,
        3)`` each.
        """
        centers = [cam.origin(frames.palm) + cam.pos for cam in self.cameras]
        rays = [
            cam.unproject(frames.sightings[:, :, i, :3]) - cam.pos
            for i, cam in enumerate(self.cameras)
        ]
        return torch.stack(centers, dim=2), torch.stack(rays, dim=2)

    def _places(self, decisions: Tensor, points: Tensor) -> Tensor:
        """Combine the positions read out, ``(B, Q, J, 3)``, linearly, and bend the result by what
        the tokens say.
        """
        anchor = points[:, :, :1]
        differences = rearrange((points - anchor) / POINT_M, "b q j i -> b q (j i)")
        combined = rearrange(self.linear(differences), "b q (k i) -> b q k i", i=3)
        features = torch.cat([decisions, differences.clamp(-MOST_UNITS, MOST_UNITS)], dim=-1)
        bend = rearrange(self.bend(features), "b q (k i) -> b q k i", i=3)
        return anchor + POINT_M * combined + bend * BEND.at(self.ahead_s)[:, None]


def _inputs(sightings: Tensor, rays: Tensor, place: Tensor) -> Tensor:
    """Return what a frame's token is made of, ``(B, T, 3 + C (6 + E))``.

    Args:
        sightings: see `Frames`.
        rays: from the cameras [m], ``(B, T, C, 3)``.
        place: where they see the target, relative to the oldest frame [m], ``(B, T, 3)``.
    """
    scales = sightings[..., 3:N_SIGHTING]
    by_camera = [
        scales.clamp(*LOG_ERRORS) / LOG_ERROR_UNIT,
        scales[..., :1].clamp_max(BLIND_LOG_ERROR).exp(),
        (rays / RAY_M).clamp(-MOST_UNITS, MOST_UNITS),
    ]
    seen = torch.cat(by_camera, dim=-1).flatten(2)
    embedding = sightings[..., N_SIGHTING:].flatten(2)
    return torch.cat([(place / PLACE_M).clamp(-MOST_UNITS, MOST_UNITS), seen, embedding], dim=-1)
