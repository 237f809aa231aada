"""The benchmark's cameras: where they are, what they look at, and how their pictures and places in space correspond.

Positions in a picture are tangents in units of half the field of view: u rightwards and v upwards in [-1, 1]. Depth is
along the camera's axis. Pictures are square.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

LEAST_DEPTH_M = 0.01


class Pinhole(nn.Module):
    """A camera that looks along +x, turned left by ``yaw_rad`` and then down by ``pitch_rad``.

    Args:
        pos_m: its position relative to the palm, or to the palm at home [m].
        pitch_rad: how far it looks down.
        yaw_rad: how far it looks to the left.
        fovy_deg: its field of view.
        carried: whether the palm carries it; if not, it stands still.
        typical_depth_m: depth whose logarithm counts as 0.
    """

    pos: Tensor
    axes: Tensor

    def __init__(
        self,
        pos_m: tuple[float, float, float],
        *,
        pitch_rad: float,
        yaw_rad: float = 0.0,
        fovy_deg: float,
        carried: bool = True,
        typical_depth_m: float = 0.4,
    ) -> None:
        super().__init__()
        self.carried, self.typical_depth_m = carried, typical_depth_m
        self.half_view = math.tan(math.radians(fovy_deg) / 2)
        self.register_buffer("pos", torch.tensor(pos_m), persistent=False)
        self.register_buffer("axes", _axes(pitch_rad, yaw_rad), persistent=False)

    def origin(self, palm: Tensor) -> Tensor:
        """Return what positions count from when the palm is at ``(..., 3)`` [m], in the frame of the state."""
        return palm if self.carried else torch.zeros_like(palm)

    def place(self, seen: Tensor) -> Tensor:
        """Map ``(u, v, log depth)`` to positions relative to the origin [m], world axes, ``(..., 3)``."""
        depth = self.typical_depth_m * seen[..., 2:].clamp(-4.0, 3.0).exp()
        ray = torch.cat([self.half_view * seen[..., :2], torch.ones_like(depth)], dim=-1)
        return self.pos + depth * ray @ self.axes

    def seen(self, place: Tensor) -> Tensor:
        """Invert `place`; what is behind the camera counts as 1 cm in front of it."""
        local = (place - self.pos) @ self.axes.T
        depth = local[..., 2:].clamp_min(LEAST_DEPTH_M)
        return torch.cat([local[..., :2] / (depth * self.half_view), (depth / self.typical_depth_m).log()], dim=-1)


def ego_camera() -> Pinhole:
    """Return the camera that the palm carries."""
    return Pinhole((-0.15, 0.03, 0.21), pitch_rad=0.45, fovy_deg=84.0)


def side_camera() -> Pinhole:
    """Return the camera that stands behind the waiting hand, to its right."""
    return Pinhole(
        (-0.65, -0.6, 0.4), pitch_rad=0.3237, yaw_rad=0.5764, fovy_deg=54.0, carried=False, typical_depth_m=1.2
    )


CAMERAS = {"ego": ego_camera, "side": side_camera}


def _axes(pitch: float, yaw: float) -> Tensor:
    """Return (3, 3) right, up and forward."""
    level = torch.tensor([math.cos(yaw), math.sin(yaw), 0.0])
    forward = math.cos(pitch) * level - torch.tensor([0.0, 0.0, math.sin(pitch)])
    right = torch.tensor([math.sin(yaw), -math.cos(yaw), 0.0])
    return torch.stack([right, torch.linalg.cross(right, forward), forward])
