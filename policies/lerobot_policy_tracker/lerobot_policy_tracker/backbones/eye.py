"""An eye that says where the target is: a coarse glance finds it, a fovea at full resolution measures it.

    glance   4 x 4 patches -> convolutions -> heat map -> its peak, by a local soft-argmax: where to look (u, v)
    fovea    the pixels around (u, v), uncompressed -> convolutions: how far off (u, v) is, and how far away
    sighting (u, v, log depth) in the camera frame, each with the scale of its error; the offset from the palm follows

The change since the image before shows what moves; an image without one counts as unchanged. Errors are taken as
Laplace distributed; their logarithmic scales tell a memory how far to trust each sighting.
"""

from __future__ import annotations

import math
from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import Tensor, nn

from ..sightings import N_SCALES, N_SIGHTING
from .base import Backbone, backbones
from .conv import StandardisedPatches, conv, saturation
from .keypoints import pixel_grid
from .pinhole import CAMERAS

N_CHANNELS = 7
"""RGB, saturation, and the change of RGB since the image before."""
CHANGE = 0.1
"""Standard deviation of a change."""
PEAK_CELLS = 2
"""The soft-argmax takes in this many cells of the heat map on each side of its peak."""
HEAT_WEIGHT = 0.3
UNSEEN_SCALE = 5.0
"""Both scales of a sighting in a black picture, which shows nothing."""
SHIPPED = {f"shipped_{name}": Path(__file__).with_name(f"eye_{name}.safetensors") for name in ("64", "96", "side_96")}
"""The weights that come with the package, by the side of the images they have learned from [px]."""


@backbones.register("eye")
class EyeBackbone(Backbone):
    """Glance and fovea; one token per frame. The geometry is that of square images.

    Args:
        width: token size.
        channels: channels of the glance at 1/4 resolution, a multiple of 8; twice as many at 1/8.
        fovea: side of the fovea [px].
        embedding: numbers that describe the fovea beside the sighting.
        camera: whose images it sees, one of `CAMERAS`.
        weights: safetensors file that training starts from, as `dynahoi pretrain` writes it; "shipped_64",
            "shipped_96" or "shipped_side_96" for those that come with the package, see `SHIPPED`; empty for none.
        frozen: train only the layer that makes tokens of what the eye sees.
    """

    locates = True
    sees_motion = True

    def __init__(
        self,
        width: int,
        *,
        channels: int = 32,
        fovea: int = 20,
        embedding: int = 64,
        camera: str = "ego",
        weights: str = "",
        frozen: bool = True,
    ) -> None:
        super().__init__(width, (0.5, 0.5, 0.5, 0.25, 0.0, 0.0, 0.0), (0.25,) * 4 + (CHANGE,) * 3)
        self.weights = weights
        if camera not in CAMERAS:
            raise ValueError(f"camera must be one of {', '.join(CAMERAS)}, got {camera!r}.")
        self.fovea, self.camera = fovea, CAMERAS[camera]()
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
        self.token = nn.Linear(self.look_dim(embedding), width)
        self.embedding = embedding
        if frozen:
            self.requires_grad_(False)
            self.token.requires_grad_(True)

    def load_pretrained(self) -> None:
        """Load what the eye has learned, if ``weights`` names a file.

        Raises:
            FileNotFoundError: if there is no such file.
        """
        if self.weights:
            self.load_state_dict(load_file(SHIPPED.get(self.weights, self.weights)), strict=False)

    def learned_state(self) -> dict[str, Tensor]:
        """Return the weights of all but the token layer, which belongs to a policy."""
        return {name: value for name, value in self.state_dict().items() if not name.startswith("token.")}

    @staticmethod
    def look_dim(embedding: int) -> int:
        """Size of what `look` returns per frame."""
        return N_SIGHTING + embedding

    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """See `Backbone.forward`; one token."""
        return self.tokens(self.look(images))

    def tokens(self, looks: Tensor) -> Tensor:
        """Map looks ``(F, L)`` to tokens ``(F, 1, D)``."""
        return self.token(looks)[:, None]

    def look(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """Return sightings and embeddings, ``(F, 3, H, W) -> (F, L)``, the sighting first.

        Its offset is from the origin of the camera, which the palm carries or which stands still.
        """
        return self.look_with_heat(images)[0]

    def look_with_heat(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return what `look` does, and the logarithmic probabilities of the heat map, ``(F, h, w)``.

        Args:
            images: RGB in [0, 1], shape ``(F, 3, H, W)``, or ``(F, 6, H, W)`` with the images before.
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

    def sightings(self, looks: Tensor, palm: Tensor) -> Tensor:
        """See `Backbone.sightings`: those in the images of the first camera."""
        first = looks[:, :, :1, :N_SIGHTING]
        carried = palm[:, :, None]
        return torch.cat([first[..., :3] + self.camera.origin(carried) - carried, first[..., 3:]], dim=-1)

    def cameras(self, palm: Tensor) -> Tensor:
        """See `Backbone.cameras`."""
        return self.camera.origin(palm[:, :, None]) + self.camera.pos

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


def sighting_loss(eye: EyeBackbone, images: Tensor, place: Tensor) -> Tensor:
    """Return the loss of each picture: heat map, Laplace likelihood of direction and depth, and error in metres.

    Args:
        eye: whose loss it is.
        images: see `EyeBackbone.look_with_heat`.
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
