"""Image encoders: an image to a sighting, which says where the target is and how sure that is.

    cells      a grid of features, by whatever network
    attention  over the cells, whose values are viewing rays (`SpatialAttention`)
    sighting   (u, v, log depth) in the camera's frame, and log scales of the errors across and
               along the line of sight

The default, the eye, looks twice: attention over the whole image finds the target, and a fovea, the
pixels around it, refines the direction and estimates the distance. The change since the image
before shows what moves. Errors are taken to be Laplace distributed.
"""

import math
from pathlib import Path
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from einops import rearrange, reduce
from safetensors.torch import load_file
from torch import Tensor, nn

from .attention import SpatialAttention
from .layers import conv, perceptron

N_SIGHTING = 5
"""Numbers of a sighting: u, v, log depth, and the log scales of the errors across and along the
line of sight."""
UNSEEN_SCALE = 5.0  # both log scales of a sighting in a black image, which shows nothing
READ_WIDTH = 128  # of the hidden layer that reads a sighting


class Encoder(nn.Module):
    """Cells of a grid, and what is seen at the place that the attention finds; a subclass
    implements `cells`, or overrides `look`.

    Args:
        dim: features of a cell.
        embedding: numbers beside the sighting that describe what is there.
        mean, std: by channel, of the images that the weights expect.
    """

    sees_motion: ClassVar[bool] = False
    """Whether it takes each image together with the one before, ``(F, 6, H, W)``."""
    pixel_mean: Tensor
    pixel_std: Tensor

    def __init__(
        self, dim: int, embedding: int, mean: Any = (0.5, 0.5, 0.5), std: Any = (0.25, 0.25, 0.25)
    ) -> None:
        super().__init__()
        self.embedding = embedding
        self.attention = SpatialAttention(dim)
        self.read = perceptron(2 * dim + 2, READ_WIDTH, N_SIGHTING + embedding)
        self.register_buffer("pixel_mean", torch.tensor(mean).view(-1, 1, 1), persistent=False)
        self.register_buffer("pixel_std", torch.tensor(std).view(-1, 1, 1), persistent=False)

    def standardize(self, images: Tensor) -> Tensor:
        """Map images in [0, 1], shape ``(F, C, H, W)``, to the range that the weights expect."""
        return (images - self.pixel_mean) / self.pixel_std

    def load_pretrained(self) -> None:
        """Load the weights that the options name; called when training starts, not when a
        checkpoint is opened.
        """

    def cells(self, images: Tensor) -> Tensor:
        """Return features ``(F, h, w, D)`` of images ``(F, 3, H, W)`` in [0, 1]."""
        raise NotImplementedError

    def forward(self, images: Tensor) -> Tensor:
        """Return sightings and embeddings, ``(F, 5 + embedding)``, of images ``(F, 3, H, W)``, RGB
        in [0, 1], or ``(F, 6, H, W)``, with those before, if it ``sees_motion``.
        """
        return self.look(images)[0]

    def look(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return what `forward` does, and the logarithm of the attention, ``(F, h, w)``."""
        cells = self.cells(images)
        ray, there, heat = self.attention(cells)
        read = self.read(torch.cat([there, reduce(cells, "f h w d -> f d", "mean"), ray], dim=-1))
        return self._sighting(images, ray, read, 2 / cells.shape[2]), heat

    def _sighting(self, images: Tensor, ray: Tensor, read: Tensor, shift_unit: float) -> Tensor:
        shift, log_depth, scales, embedding = read.split([2, 1, 2, self.embedding], dim=-1)
        scales = torch.where(images[:, :3].amax((1, 2, 3))[:, None] > 0, scales, UNSEEN_SCALE)
        return torch.cat([ray + shift_unit * shift, log_depth, scales, embedding], dim=-1)


EYE_PX = 96  # side of the images that the eyes that ship have learned from
SHIPPED = {
    f"{view}_{EYE_PX}": Path(__file__).with_name(f"eye_{view}_{EYE_PX}.safetensors")
    for view in ("ego", "side")
}
"""The eyes that come with the package, by view and side of the images [px]."""
PIXEL_MEAN = (0.5, 0.5, 0.5, 0.25, 0.0, 0.0, 0.0)
PIXEL_STD = (0.25, 0.25, 0.25, 0.25, 0.1, 0.1, 0.1)
"""Mean and standard deviation of RGB, saturation, and the change of RGB since the image before."""


class Eye(Encoder):
    """Glance and fovea: `look` is its own, and reads the fovea beside the cells of the glance.

    Args:
        embedding: see `Encoder`.
        channels: channels of the glance at 1/4 resolution, a multiple of 8; twice as many at 1/8.
        fovea: side of the fovea [px].
        weights: safetensors file to start from, as `dynahoi pretrain` writes it, or the name of one
            that ships, see `SHIPPED`; empty for random weights.
    """

    sees_motion = True

    def __init__(
        self, embedding: int = 0, *, channels: int = 32, fovea: int = 20, weights: str = ""
    ) -> None:
        super().__init__(channels, embedding, PIXEL_MEAN, PIXEL_STD)
        self.weights = weights
        self.fovea = fovea
        self.patches = nn.Conv2d(len(PIXEL_MEAN), channels, kernel_size=4, stride=4)
        self.refine = conv(channels, channels)
        self.deep = nn.Sequential(
            conv(channels, 2 * channels, stride=2), conv(2 * channels, 2 * channels)
        )
        self.lateral = nn.Conv2d(2 * channels, channels, kernel_size=1)
        self.merge = conv(channels, channels)
        self.foveal = nn.Sequential(
            conv(len(PIXEL_MEAN), 16), conv(16, 32, stride=2), conv(32, 64, stride=2), nn.Flatten(),
            nn.Linear(64 * math.ceil(fovea / 4) ** 2, READ_WIDTH), nn.SiLU(),
        )  # fmt: skip
        # in place of the one of `Encoder`, which reads cells alone
        self.read = perceptron(READ_WIDTH + 3 * channels + 2, READ_WIDTH, N_SIGHTING + embedding)

    def load_pretrained(self) -> None:
        """Load ``weights``.

        Raises:
            ValueError: if there is no such file, and no such eye ships.
        """
        if not self.weights:
            return
        path = Path(SHIPPED.get(self.weights, self.weights))
        if not path.is_file():
            known = ", ".join(SHIPPED)
            raise ValueError(f"weights is {self.weights!r}, but must be a file or one of {known}.")
        self.load_state_dict(load_file(path))

    def look(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """See `Encoder.look`."""
        now = images[:, :3]
        before = images[:, -3:]
        saturation = now.amax(1, keepdim=True) - now.amin(1, keepdim=True)
        pixels = torch.cat([now, saturation, now - before], dim=1)
        pixels = pixels.contiguous(memory_format=torch.channels_last)
        fine = self.refine(self._patches(pixels))  # (F, C, H/4, W/4)
        deep = self.deep(fine)
        fine = self.merge(fine + F.interpolate(self.lateral(deep), size=fine.shape[-2:]))
        ray, there, heat = self.attention(rearrange(fine, "f c h w -> f h w c"))
        seen = self.foveal(self._crop(pixels, ray.detach()))
        everywhere = reduce(deep, "f c h w -> f c", "mean")
        read = self.read(torch.cat([seen, there, everywhere, ray], dim=-1))
        return self._sighting(images, ray, read, self.fovea / images.shape[-1]), heat

    def _patches(self, pixels: Tensor) -> Tensor:
        """Return the patches of pixels; `standardize` is folded into the weights."""
        assert self.patches.bias is not None
        weight = self.patches.weight / self.pixel_std
        shift = reduce(weight * self.pixel_mean, "o i y x -> o", "sum")
        return F.conv2d(pixels, weight, self.patches.bias - shift, stride=self.patches.stride)

    def _crop(self, pixels: Tensor, ray: Tensor) -> Tensor:
        """Cut squares of ``fovea`` pixels around rays ``(F, 2)``, standardized."""
        steps = torch.linspace(-1, 1, self.fovea, device=pixels.device) * (self.fovea - 1)
        height, width = pixels.shape[-2:]
        x = ray[:, :1] + steps / width  # (F, fovea), in image coordinates
        y = -ray[:, 1:] + steps / height
        grid = torch.stack(torch.broadcast_tensors(x[:, None, :], y[:, :, None]), dim=-1)
        crop = F.grid_sample(pixels, grid, padding_mode="border", align_corners=False)
        return self.standardize(crop)


class Conv(Encoder):
    """A small convolutional network, trained from scratch.

    Args:
        embedding: see `Encoder`.
        channels: at 1/4 resolution, a multiple of 8.
    """

    def __init__(self, embedding: int = 64, *, channels: int = 32) -> None:
        super().__init__(2 * channels, embedding)
        self.net = nn.Sequential(
            nn.Conv2d(3, channels, kernel_size=4, stride=4),
            conv(channels, channels),
            conv(channels, 2 * channels, stride=2),
        )

    def cells(self, images: Tensor) -> Tensor:
        """See `Encoder.cells`; 1/8 resolution."""
        return rearrange(self.net(self.standardize(images)), "f c h w -> f h w c")


class TransformersVision(Encoder):
    """Any vision tower of ``transformers`` (SigLIP, DINOv2, CLIP, ViT, ConvNeXt, ...).

    Args:
        embedding: see `Encoder`.
        name: Hub name or folder; its ``config.json`` is needed whenever the policy is opened, its
            weights only when training starts.
    """

    def __init__(self, embedding: int = 64, *, name: str = "facebook/dinov2-small") -> None:
        from transformers import AutoConfig, AutoModel, ImageProcessingMixin

        settings, _ = ImageProcessingMixin.get_image_processor_dict(name)
        config = AutoConfig.from_pretrained(name)
        vision = getattr(config, "vision_config", config)
        dim = vision.hidden_sizes[-1] if hasattr(vision, "hidden_sizes") else vision.hidden_size
        super().__init__(dim, embedding, settings["image_mean"], settings["image_std"])
        self.name = name
        self.input_px = getattr(vision, "image_size", None)
        model = AutoModel.from_config(config)
        # of a model that also reads text, the image side
        self.tower = getattr(model, "vision_model", model)

    def load_pretrained(self) -> None:
        """Load the tower's published weights."""
        from transformers import AutoModel

        model = AutoModel.from_pretrained(self.name)
        self.tower.load_state_dict(getattr(model, "vision_model", model).state_dict())

    def cells(self, images: Tensor) -> Tensor:
        """See `Encoder.cells`; class tokens are left out."""
        if self.input_px:
            images = F.interpolate(
                images, (self.input_px,) * 2, mode="bilinear", align_corners=False
            )
        features = self.tower(pixel_values=self.standardize(images)).last_hidden_state
        if features.dim() == 4:
            return rearrange(features, "f d h w -> f h w d")
        side = math.isqrt(features.shape[1])
        return rearrange(features[:, -(side**2) :], "f (h w) d -> f h w d", h=side)


ENCODERS: dict[str, type[Encoder]] = {"eye": Eye, "conv": Conv, "transformers": TransformersVision}
