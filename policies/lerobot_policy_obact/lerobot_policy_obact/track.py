"""The target's track: sightings from a moving hand, put together in one frame that does not move.

A sighting is an offset from the palm. Added to where the palm was, the sightings of many frames are points of one path.
Motion models are fitted to the latest of them in two ways, as places and as lines of sight. Where the target goes next
is a mixture of what they expect, which the head learns; how badly each fits tells it which of them to believe.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .decisions import Decisions
from .frames import EncodedFrames
from .motion_models import MODELS, fit_places, powers
from .triangulation import fit_lines_of_sight

N_SIGHTING = 8
"""Numbers of a sighting: offset from the palm [m] (3), u, v and log depth in the camera frame (3), logarithmic scales
of the errors across and along the line of sight (2)."""
LENGTH_M, TYPICAL_SPEED_M_S, TYPICAL_ACCELERATION_M_S2 = 0.3, 0.5, 5.0
"""By which positions, velocities and accelerations are divided before a network sees them."""
LEAST_ERROR_M = 0.003
N_FITS = 2 * len(MODELS)
N_TRACK = (9 + 1) * N_FITS + N_SIGHTING


@dataclass(frozen=True)
class Track:
    """Where the target of each of ``R`` decisions is, relative to the palm.

    Attributes:
        motion: position [m], velocity [m/s] and acceleration [m/s^2] now, by each of `MODELS` fitted to places, then to
            lines of sight, shape ``(R, N_FITS, 3, 3)``.
        misfit: of each fit, in units of the expected errors of the sightings, shape ``(R, N_FITS)``.
        sighting: of the current frame, shape ``(R, N_SIGHTING)``.
    """

    motion: Tensor
    misfit: Tensor
    sighting: Tensor

    @classmethod
    def of(cls, frames: EncodedFrames, decisions: Decisions, position: Tensor, camera_pos: Tensor) -> Track:
        """Fit the tracks of decisions.

        Args:
            frames: with sightings.
            decisions: which are wanted.
            position: where their hands are, in the unit of the state, shape ``(R, P)``.
            camera_pos: the camera's position relative to the palm [m], shape ``(3,)``.
        """
        places = frames.position[..., :3] + frames.sightings[..., :3]  # (B, T, 3)
        points = decisions.windows(places) - position[:, None, :3]  # (R, W, 3)
        seen, keep = decisions.windows(frames.sightings), decisions.pick(decisions.keep)  # (R, W, S), (R, W)
        rays = seen[..., :3] - camera_pos
        with torch.autocast(points.device.type, enabled=False):  # half precision would move a fit by millimetres
            of_places = fit_places(points, keep / sighting_error(seen).square(), decisions.age_s)
            of_lines = fit_lines_of_sight(points, rays, keep[..., None] / errors_of_sight(seen, rays), decisions.age_s)
        motion, misfit = (torch.cat(fits, dim=1) for fits in zip(of_places, of_lines, strict=True))
        return cls(motion, misfit, decisions.current(frames.sightings))

    def features(self) -> Tensor:
        """Return all of it in units of about one, ``(R, N_TRACK)``."""
        unit = self.motion.new_tensor([[LENGTH_M], [TYPICAL_SPEED_M_S], [TYPICAL_ACCELERATION_M_S2]])
        return torch.cat([(self.motion / unit).flatten(1), self.misfit.log1p(), scaled(self.sighting)], dim=-1)

    def along(self, ahead_s: Tensor) -> Tensor:
        """Return where each fit leads at times ``(K,)`` [s], ``(R, N_FITS, K, 3)``."""
        return powers(-ahead_s) @ self.motion

    def along_line(self, ahead_s: Tensor, damping: Tensor) -> Tensor:
        """Return where the straight line leads at times ``(K,)`` [s], slowed down by ``(R, K)``, ``(R, K, 3)``."""
        position, velocity = self.motion[:, 0, None, 0], self.motion[:, 0, None, 1]
        return position + velocity * (ahead_s * damping)[..., None]


def sighting_error(sightings: Tensor) -> Tensor:
    """Return the expected errors across and along the line of sight together [m], ``(..., N_SIGHTING) -> (...)``."""
    distance = sightings[..., :3].norm(dim=-1) + 0.1
    return (distance * _scales(sightings).norm(dim=-1)).clamp_min(LEAST_ERROR_M)


def errors_of_sight(sightings: Tensor, rays: Tensor) -> Tensor:
    """Return the expected errors across and along rays from the camera ``(..., 3)`` [m], ``(..., 2)``."""
    distance = rays.norm(dim=-1, keepdim=True)
    return (distance * _scales(sightings)).clamp_min(LEAST_ERROR_M)


def _scales(sightings: Tensor) -> Tensor:
    return sightings[..., 6:8].clamp(-5.0, 5.0).exp()


def scaled(sightings: Tensor) -> Tensor:
    """Divide the offsets of sightings by a typical length."""
    return torch.cat([sightings[..., :3] / LENGTH_M, sightings[..., 3:]], dim=-1)


class MotionEncoder(nn.Module):
    """Encodes where the target and the palm are at one frame, in a frame that does not move.

    Args:
        width: token size.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(N_SIGHTING + 6, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, sightings: Tensor, position: Tensor) -> Tensor:
        """Map sightings ``(B, T, N_SIGHTING)`` and states ``(B, T, P)`` to tokens ``(B, T, D)``."""
        palm = position[..., :3]
        return self.net(torch.cat([scaled(sightings), palm / LENGTH_M, (palm + sightings[..., :3]) / LENGTH_M], dim=-1))
