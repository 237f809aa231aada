"""Belief: what the frames observed so far say about where the target is and where it will be."""

from dataclasses import dataclass, replace
from typing import cast

import torch
from einops import einsum, rearrange, repeat
from torch import Tensor, nn

from .attention import Memory, PositionReadout, TemporalBlock
from .camera import Pinhole
from .frames import Record
from .heads import perceptron

FORECAST_FRAMES = (0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48)
"""Frames ahead at which the target's position is forecast."""
PLACE_M, RAY_M, POINT_M = 0.3, 0.4, 0.1
"""Units in which places, their offsets from the camera and differences between points enter the network."""
FAR = 8.0
"""Inputs are cut to this many units."""


@dataclass(frozen=True)
class Outlook(Record):
    """What decisions, ``(B, Q)``, believe.

    Attributes:
        features: ``(B, Q, D)``.
        forecast: of the target [m], ``(B, Q, K, 3)``, see `FORECAST_FRAMES`.
        weights: of the S frames observed in the J positions that were read out, ``(B, Q, J, S)``; None without those.
    """

    features: Tensor
    forecast: Tensor
    weights: Tensor | None = None

    def at(self, q: int | slice) -> "Outlook":
        """Return that of some of the decisions, or of one, ``(B, ...)``."""
        return self.map(lambda x: x[:, q])

    def repeated(self, m: int) -> "Outlook":
        """Return that of each decision ``m`` times, ``(B * Q * m, ...)``."""
        return replace(self, weights=None).map(lambda x: repeat(x, "b q ... -> (b q m) ...", m=m))

    def unflattened(self, b: int) -> "Outlook":
        """Return that of decisions ``(b * Q, 1)`` as ``(b, Q)``."""
        return self.map(lambda x: rearrange(x, "(b q) 1 ... -> b q ...", b=b))


class Belief(nn.Module):
    """Tokens of frames, causal attention over them, and a forecast that combines positions sighted earlier.

    Args:
        cameras: calibrated.
        n_extra: numbers of a token beside those of the sightings.
        dim, n_layers, n_heads, n_points: see `ObActConfig`.
        fps: frame rate [Hz].
    """

    ahead_s: Tensor

    def __init__(
        self, cameras: list[Pinhole], n_extra: int, *, dim: int, n_layers: int, n_heads: int, n_points: int, fps: float
    ) -> None:
        super().__init__()
        self.n_points = n_points
        self._cameras = nn.ModuleList(cameras)
        self.register_buffer("ahead_s", torch.tensor(FORECAST_FRAMES) / fps, persistent=False)
        self.token = perceptron(3 + 6 * len(cameras) + n_extra, dim, dim)
        self.blocks = nn.ModuleList(TemporalBlock(dim, n_heads) for _ in range(n_layers))
        self.norm = nn.LayerNorm(dim)
        k = len(FORECAST_FRAMES)
        if n_points:
            self.readout = PositionReadout(dim, n_points)
            self.linear = nn.Linear(3 * n_points, 3 * k, bias=False)
            nn.init.zeros_(self.linear.weight)
        else:
            self.now = nn.Linear(dim, 3)
        last = nn.Linear(256, 3 * k)
        nn.init.zeros_(last.weight)
        self.bend = nn.Sequential(perceptron(dim + 3 * n_points, 256, 256), nn.SiLU(), last)

    @property
    def cameras(self) -> list[Pinhole]:
        """The cameras."""
        return cast("list[Pinhole]", list(self._cameras))

    def forward(
        self,
        sightings: Tensor,
        palm: Tensor,
        extra: Tensor,
        time_s: Tensor,
        rows: Tensor,
        *,
        memory: Memory | None = None,
    ) -> Outlook:
        """Return what decisions at frames ``rows`` ``(B, Q)`` believe.

        Args:
            sightings: in T frames by camera, ``(B, T, C, 5)``.
            palm: where the palm is [m], ``(B, T, 3)``.
            extra: what else a token holds, ``(B, T, E)``.
            time_s: when the frames were seen [s], ``(T,)``, rising.
            rows: frames of the decisions.
            memory: of frames before these, which it also is to keep.
        """
        memory = memory or Memory()
        (eyes, rays), scales = self.sighted(sightings, palm), sightings[..., 3:5]
        position = fused(eyes, rays, scales)
        origin = memory.first("origin", position[:, :1])
        seen = [scales.clamp(-6, 3) / 3, scales[..., :1].clamp_max(2).exp(), (rays / RAY_M).clamp(-FAR, FAR)]
        place = ((position - origin) / PLACE_M).clamp(-FAR, FAR)
        tokens = self.token(torch.cat([place, torch.cat(seen, dim=-1).flatten(2), extra], dim=-1))
        age_s = time_s[:, None] - memory.extended("time", time_s, 0)  # (T, S), negative ahead
        for block in self.blocks:
            tokens = block(tokens, age_s, memory)
        tokens = self.norm(tokens)
        chosen = repeat(rows, "b q -> b q d", d=tokens.shape[-1])
        features, points, weights = tokens.gather(1, chosen), None, None
        if self.n_points:
            points, weights = self.readout(tokens, position - origin, age_s, rows, memory)
        return Outlook(features, self._forecast(features, points) + origin[:, :, None], weights)

    def sighted(self, sightings: Tensor, palm: Tensor) -> tuple[Tensor, Tensor]:
        """Return where the cameras are, and where from there they see the target [m], ``(B, T, C, 3)`` each."""
        eyes = [cam.origin(palm) + cam.pos for cam in self.cameras]
        rays = [cam.place(sightings[:, :, i, :3]) - cam.pos for i, cam in enumerate(self.cameras)]
        return torch.stack(eyes, dim=2), torch.stack(rays, dim=2)

    def _forecast(self, decisions: Tensor, points: Tensor | None) -> Tensor:
        """Combine the positions read out, ``(B, Q, J, 3)``, linearly, and bend the result by what the tokens say."""
        if points is None:
            base, features = PLACE_M * self.now(decisions)[:, :, None], decisions
        else:
            anchor = points[:, :, :1]
            differences = rearrange((points - anchor) / POINT_M, "b q j i -> b q (j i)")
            base = anchor + POINT_M * rearrange(self.linear(differences), "b q (k i) -> b q k i", i=3)
            features = torch.cat([decisions, differences.clamp(-FAR, FAR)], dim=-1)
        bend = rearrange(self.bend(features), "b q (k i) -> b q k i", i=3)
        return base + bend * (0.03 + 0.5 * self.ahead_s)[:, None]


def fused(eyes: Tensor, rays: Tensor, scales: Tensor) -> Tensor:
    """Return where the cameras together place the target [m], ``(B, T, 3)``: each counts by what it is sure of.

    A camera's error is taken to be Gaussian with the ``scales`` ``(B, T, C, 2)`` it reports, across and along its line
    of sight, so the lines of sight of two cameras cross where both are precise. See `Belief.sighted` for the others.
    """
    if eyes.shape[2] == 1:
        return (eyes + rays)[:, :, 0]
    distance = rays.norm(dim=-1, keepdim=True).clamp_min(1e-3)
    sight = rays / distance
    across, along = ((scales.clamp(-6, 2).exp() * distance).clamp_min(1e-3) ** -2)[..., None].unbind(-2)  # (B, T, C, 1)
    line = einsum(sight, sight, "... i, ... j -> ... i j")
    precise = across[..., None] * (torch.eye(3, device=line.device) - line) + along[..., None] * line
    return torch.linalg.solve(precise.sum(2), (precise @ (eyes + rays)[..., None]).sum(2))[..., 0]
