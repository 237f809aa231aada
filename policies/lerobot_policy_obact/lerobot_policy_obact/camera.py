"""Pinhole cameras: between (u, v, log depth) in an image and positions relative to the palm, and
where several of them together place a target.
"""

import math
from typing import Self

import torch
from einops import einsum
from torch import Tensor, nn

LEAST_DEPTH_M = 0.01  # what is behind a camera counts as this far in front of it
UNIT_PER_DISTANCE = 1.5
"""Depth whose logarithm counts as 0, in distances of the camera from the palm at home."""
LOG_DEPTHS = (-4.0, 3.0)
"""Log depths are cut to these, from 2 % of that depth to twenty times as far: an eye that has seen
nothing may say anything."""
LOG_ERRORS = (-6.0, 3.0)
"""Log scales of a sighting's errors are cut to these: 0.2 % of the distance is less than a pixel,
and twenty times the distance says that nothing was seen."""
BLIND_LOG_ERROR = 2.0
"""Where scales count as numbers, they are cut here: an error of seven times the distance tells
nothing."""
LEAST_M = 1e-3  # distances and errors are at least this, so that none outvotes all others


class Pinhole(nn.Module):
    """A calibrated camera with square images.

    ``(u, v)`` span -1 to 1, to the right and upwards; the log depth is along the camera's axis, 0
    at ``unit_m``.

    Args:
        pos_m: its position from the palm, or, if it stands still, from where the palm waits [m].
        axes: its axes to the right, upwards and forward, rows of a rotation matrix, world axes.
        half_view: tangent of half its field of view.
        carried: whether the palm carries it.
    """

    pos: Tensor
    axes: Tensor

    def __init__(
        self, pos_m: list[float], axes: list[list[float]], half_view: float, *, carried: bool
    ) -> None:
        super().__init__()
        self.half_view = half_view
        self.carried = carried
        self.unit_m = UNIT_PER_DISTANCE * math.hypot(*pos_m) or 1.0
        self.register_buffer("pos", torch.tensor(pos_m, dtype=torch.float32), persistent=False)
        self.register_buffer("axes", torch.tensor(axes, dtype=torch.float32), persistent=False)

    @classmethod
    def from_pose(cls, pose: list[float], half_view: float, *, carried: bool) -> Self:
        """Return the camera of a pose, position [m] and quaternion wxyz, that looks along its -z
        with y up.
        """
        w, x, y, z = pose[3:]
        right = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
        up = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
        forward = [-2 * (x * z + w * y), -2 * (y * z - w * x), -(1 - 2 * (x * x + y * y))]
        return cls(list(pose[:3]), [right, up, forward], half_view, carried=carried)

    def origin(self, palm: Tensor) -> Tensor:
        """Return the origin of positions when the palm is at ``(..., 3)`` [m], in the frame of the
        state.
        """
        return palm if self.carried else torch.zeros_like(palm)

    def unproject(self, seen: Tensor) -> Tensor:
        """Map ``(u, v, log depth)`` to positions from the origin [m], world axes, ``(..., 3)``."""
        depth = self.unit_m * seen[..., 2:].clamp(*LOG_DEPTHS).exp()
        ray = torch.cat([self.half_view * seen[..., :2], torch.ones_like(depth)], dim=-1)
        return self.pos + depth * ray @ self.axes

    def project(self, place: Tensor) -> Tensor:
        """Invert `unproject`."""
        local = (place - self.pos) @ self.axes.T
        depth = local[..., 2:].clamp_min(LEAST_DEPTH_M)
        return torch.cat(
            [local[..., :2] / (depth * self.half_view), (depth / self.unit_m).log()], dim=-1
        )


def fused(centers: Tensor, rays: Tensor, scales: Tensor) -> Tensor:
    """Return where the cameras together place the target [m], ``(B, T, 3)``: each counts by what it
    is sure of.

    A camera's error is taken to be Gaussian with the ``scales`` ``(B, T, C, 2)`` it reports, across
    and along its line of sight, so the lines of sight of two cameras cross where both are precise.
    See `Forecaster.sighted` for the other arguments.
    """
    if centers.shape[2] == 1:
        return (centers + rays)[:, :, 0]
    distance = rays.norm(dim=-1, keepdim=True).clamp_min(LEAST_M)
    errors_m = scales.clamp(LOG_ERRORS[0], BLIND_LOG_ERROR).exp() * distance
    across, along = (errors_m.clamp_min(LEAST_M) ** -2)[..., None].unbind(-2)  # (B, T, C, 1)
    sight = rays / distance
    line = einsum(sight, sight, "... i, ... j -> ... i j")
    plane = torch.eye(3, device=line.device) - line
    precision = across[..., None] * plane + along[..., None] * line  # (B, T, C, 3, 3)
    weighted = precision @ (centers + rays)[..., None]
    return torch.linalg.solve(precision.sum(2), weighted.sum(2))[..., 0]
