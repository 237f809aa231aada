"""Image encoders: the eye, which says where the target is by attention over image cells.

    glance   4 x 4 patches -> convolutions -> attention over the cells of the image, whose values are viewing directions
    fovea    the pixels around that direction, uncompressed -> how far off it is, and how far away the target is
    sighting (u, v, log depth) in the camera frame, each with the scale of its error; the offset from the palm follows

The change since the previous image shows what moves; an image without one counts as unchanged. Errors are taken to be
Laplace distributed; their log scales tell the policy how far to trust each sighting.
"""

from __future__ import annotations

import math
from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import Tensor, nn

N_SCALES = 2
"""Log scales of the errors of a sighting: across the line of sight [tangent], and of the log depth."""
N_SIGHTING = 3 + 3 + N_SCALES
"""Numbers of a sighting: offset from the camera's origin [m], (u, v, log depth) in the camera frame, scales."""
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


N_CHANNELS = 7
"""RGB, saturation, and the change of RGB since the previous image."""
PIXEL_MEAN, PIXEL_STD = (0.5, 0.5, 0.5, 0.25, 0.0, 0.0, 0.0), (0.25, 0.25, 0.25, 0.25, 0.1, 0.1, 0.1)
PEAK_CELLS = 2
"""The soft-argmax takes in this many cells of the heat map on each side of its peak."""
HEAT_WEIGHT = 0.3
UNSEEN_SCALE = 5.0
"""Both scales of a sighting in a black image, which shows nothing."""
SHIPPED = {f"shipped_{name}": Path(__file__).with_name(f"eye_{name}.safetensors") for name in ("64", "96", "side_96")}
"""The weights that come with the package, by the side of the images they have learned from [px]."""


class Eye(nn.Module):
    """Glance and fovea over square images of one camera.

    Args:
        channels: channels of the glance at 1/4 resolution, a multiple of 8; twice as many at 1/8.
        fovea: side of the fovea [px].
        embedding: numbers that describe the fovea beside the sighting.
        camera: whose images it sees, one of `CAMERAS`.
        weights: safetensors file to start from, as `dynahoi pretrain` writes it, or the name of one that ships, see
            `SHIPPED`; empty for random weights.
        frozen: whether training leaves its weights alone.

    Raises:
        ValueError: if there is no such camera.
    """

    pixel_mean: Tensor
    pixel_std: Tensor

    def __init__(
        self,
        *,
        channels: int = 32,
        fovea: int = 20,
        embedding: int = 64,
        camera: str = "ego",
        weights: str = "",
        frozen: bool = True,
    ) -> None:
        super().__init__()
        if camera not in CAMERAS:
            raise ValueError(f"camera must be one of {', '.join(CAMERAS)}, got {camera!r}.")
        self.weights, self.fovea, self.embedding, self.camera = weights, fovea, embedding, CAMERAS[camera]()
        for name, value in (("pixel_mean", PIXEL_MEAN), ("pixel_std", PIXEL_STD)):
            self.register_buffer(name, torch.tensor(value).view(-1, 1, 1), persistent=False)
        self.patches, self.refine = StandardisedPatches(N_CHANNELS, channels), conv(channels, channels)
        self.deep = nn.Sequential(conv(channels, 2 * channels, stride=2), conv(2 * channels, 2 * channels))
        self.lateral = nn.Conv2d(2 * channels, channels, kernel_size=1)
        self.merge = conv(channels, channels)
        self.heat = nn.Conv2d(channels, 1, kernel_size=1)
        self.foveal = nn.Sequential(
            conv(N_CHANNELS, 16), conv(16, 32, stride=2), conv(32, 64, stride=2), nn.Flatten(),
            nn.Linear(64 * math.ceil(fovea / 4) ** 2, 128), nn.SiLU(),
        )  # fmt: skip
        self.read = nn.Sequential(
            nn.Linear(128 + 3 * channels + 2, 128), nn.SiLU(), nn.Linear(128, embedding + 3 + N_SCALES)
        )
        self.requires_grad_(not frozen)

    def load_pretrained(self) -> None:
        """Load ``weights``, if it names a file.

        Raises:
            FileNotFoundError: if there is no such file.
        """
        if self.weights:
            self.load_state_dict(load_file(SHIPPED.get(self.weights, self.weights)), strict=False)

    def look(self, images: Tensor) -> Tensor:
        """Return sightings and embeddings, ``(F, 3, H, W) -> (F, L)``, the sighting first.

        Its offset is from the origin of the camera, which the palm carries or which stands still.
        """
        return self.look_with_heat(images)[0]

    def look_with_heat(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return what `look` does, and the logarithmic probabilities of the heat map, ``(F, h, w)``.

        Args:
            images: RGB in [0, 1], shape ``(F, 3, H, W)``, or ``(F, 6, H, W)`` with the previous images.
        """
        now, before = images[:, :3], images[:, -3:]
        pixels = torch.cat([now, saturation(now), now - before], dim=1).contiguous(memory_format=torch.channels_last)
        heat, fine, room = self._glance(pixels)
        centre, glance = self._peak(heat, fine)
        seen = self.foveal(self._crop(pixels, centre.detach()))
        read = self.read(torch.cat([seen, glance, room, centre], dim=-1))
        shift, log_depth, scales, embedding = read.split([2, 1, N_SCALES, self.embedding], dim=-1)
        scales = torch.where(now.amax((1, 2, 3))[:, None] > 0, scales, UNSEEN_SCALE)
        sighted = torch.cat([centre + self.fovea / images.shape[-1] * shift, log_depth], dim=-1)
        return torch.cat([self.camera.place(sighted), sighted, scales, embedding], dim=-1), heat

    def _glance(self, pixels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the logarithmic heat map ``(F, h, w)``, features under it ``(F, C, h, w)`` and of all ``(F, 2C)``."""
        fine = self.refine(self.patches(pixels, self.pixel_mean, self.pixel_std))  # (F, C, H/4, W/4)
        deep = self.deep(fine)
        fine = self.merge(fine + F.interpolate(self.lateral(deep), size=fine.shape[-2:]))
        heat = self.heat(fine)[:, 0]
        return heat.flatten(1).log_softmax(-1).view_as(heat), fine, deep.mean((-2, -1))

    def _peak(self, heat: Tensor, fine: Tensor) -> tuple[Tensor, Tensor]:
        """Return where the peak is, ``(F, 2)``, and the features there, ``(F, C)``.

        A mean over the whole map would look between two things that may be the target; the peak is one of them.
        """
        grid = pixel_grid(heat.shape[-2], heat.shape[-1], heat.device)  # (h * w, 2), rows downwards
        flat = heat.flatten(1)
        reach = 2.0 * (PEAK_CELLS + 0.5) / heat.new_tensor([heat.shape[-1], heat.shape[-2]])
        far = ((grid - grid[flat.argmax(-1)][:, None]).abs() > reach).any(-1)  # (F, h * w)
        weights = flat.masked_fill(far, float("-inf")).softmax(-1)
        centre = weights @ grid.to(weights.dtype)
        return centre * centre.new_tensor([1.0, -1.0]), (fine.flatten(2) @ weights[..., None])[..., 0]

    def _crop(self, pixels: Tensor, centre: Tensor) -> Tensor:
        """Cut squares of ``fovea`` pixels around ``centre``, ``(F, N_CHANNELS, h, w)``, standardised."""
        steps = torch.linspace(-1, 1, self.fovea, device=pixels.device) * (self.fovea - 1)
        height, width = pixels.shape[-2:]
        x, y = centre[:, :1] + steps / width, -centre[:, 1:] + steps / height  # (F, fovea) each, in image coordinates
        grid = torch.stack(torch.broadcast_tensors(x[:, None, :], y[:, :, None]), dim=-1)
        crop = F.grid_sample(pixels, grid, padding_mode="border", align_corners=False)
        return (crop - self.pixel_mean) / self.pixel_std


def sighting_loss(eye: Eye, images: Tensor, place: Tensor) -> Tensor:
    """Return the loss of each image: heat map, Laplace likelihood of direction and depth, and error in metres.

    Args:
        eye: whose loss it is.
        images: see `Eye.look_with_heat`.
        place: where the target truly is, relative to the camera's origin [m], world axes, shape ``(F, 3)``.
    """
    looks, heat = eye.look_with_heat(images)
    seen, scales = looks[:, 3:6], looks[:, 6:8]
    true = eye.camera.seen(place)
    across = (seen[:, :2] - true[:, :2]).square().sum(-1).add(1e-8).sqrt()
    along = (seen[:, 2] - true[:, 2]).abs()
    error = torch.stack([across, along], dim=-1)  # (F, 2)
    likelihood = (error * (-scales).exp() + scales * scales.new_tensor([2.0, 1.0])).sum(-1)
    metric = (looks[:, :3] - place).norm(dim=-1) / (0.05 + 0.3 * place.norm(dim=-1))
    return HEAT_WEIGHT * _heat_loss(heat, true) + 0.1 * likelihood + across + along + metric.clamp_max(4.0)


def _heat_loss(heat: Tensor, true: Tensor) -> Tensor:
    """Return the cross-entropy of the cell that the target is in, 0 where it is out of view, shape ``(F,)``."""
    size = true.new_tensor([heat.shape[-1], heat.shape[-2]])
    place = ((true[:, :2] * true.new_tensor([1.0, -1.0]) + 1) / 2 * size).floor().long()
    cell = torch.minimum(place.clamp_min(0), size.long() - 1)
    return -heat[torch.arange(len(heat)), cell[:, 1], cell[:, 0]] * (place == cell).all(-1)


class StandardisedPatches(nn.Conv2d):
    """Patch embedding: a 4 x 4 convolution of stride 4, cheaper than two strided convolutions at full resolution.

    The standardisation of the pixels is folded into its weights, which are far fewer.

    Args:
        n_in: input channels.
        n_out: output channels.
    """

    def __init__(self, n_in: int, n_out: int) -> None:
        super().__init__(n_in, n_out, kernel_size=4, stride=4)

    def forward(self, images: Tensor, mean: Tensor, std: Tensor) -> Tensor:
        """Convolve ``(images - mean) / std``, of shapes ``(F, C, H, W)`` and ``(C, 1, 1)``."""
        weight = self.weight / std  # (C', C, 4, 4)
        shift = (weight * mean).sum((1, 2, 3))  # (C',)
        return F.conv2d(images, weight, -shift if self.bias is None else self.bias - shift, self.stride)


def saturation(images: Tensor) -> Tensor:
    """Return the largest minus the smallest channel of each pixel, ``(F, 3, H, W) -> (F, 1, H, W)`` in [0, 1]."""
    return images.amax(1, keepdim=True) - images.amin(1, keepdim=True)


def conv(n_in: int, n_out: int, stride: int = 1) -> nn.Sequential:
    """Return a 3 x 3 convolution with normalisation by groups of eight channels, and its activation."""
    return nn.Sequential(
        nn.Conv2d(n_in, n_out, kernel_size=3, stride=stride, padding=1, bias=False),
        nn.GroupNorm(n_out // 8, n_out),
        nn.SiLU(inplace=True),
    )


def pixel_grid(height: int, width: int, device: torch.device) -> Tensor:
    """Return cell centres as (x, y) in [-1, 1], shape ``(height * width, 2)``."""
    y = (torch.arange(height, device=device) + 0.5) / height * 2 - 1
    x = (torch.arange(width, device=device) + 0.5) / width * 2 - 1
    rows, columns = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([columns, rows], dim=-1).flatten(0, 1)
