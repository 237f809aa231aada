"""Image encoders: an image to a sighting, which says where the target is and how sure that is.

    cells      a grid of features, by whatever network
    attention  over the cells, whose values are viewing rays (`SpatialAttention`)
    sighting   (u, v, log depth) in the camera's frame, and log scales of the errors across and along the line of sight

The default, the eye, looks twice: attention over the whole image finds the target, and a fovea, the pixels around it,
refines the direction and estimates the distance. The change since the image before shows what moves. Errors are taken
to be Laplace distributed.
"""

import math
from pathlib import Path
from typing import Any, ClassVar, cast

import torch
import torch.nn.functional as F
from einops import rearrange, reduce
from safetensors.torch import load_file
from torch import Tensor, nn

from .attention import SpatialAttention

N_SIGHTING = 5
"""Numbers of a sighting: u, v, log depth, and the log scales of the errors across and along the line of sight."""
UNSEEN_SCALE = 5.0
"""Both log scales of a sighting in a black image, which shows nothing."""


class Encoder(nn.Module):
    """Cells of a grid, and what is seen at the place that the attention finds.

    A subclass says what the ``cells`` are. Registered in `ENCODERS`.

    Args:
        dim: features of a cell.
        embedding: numbers beside the sighting that describe what is there.
        mean, std: by channel, of the images that the weights expect.
    """

    sees_motion: ClassVar[bool] = False
    """Whether it takes each image together with the one before, ``(F, 6, H, W)``."""
    reads_text: ClassVar[bool] = False
    pixel_mean: Tensor
    pixel_std: Tensor

    def __init__(self, dim: int, embedding: int, mean: Any = (0.5, 0.5, 0.5), std: Any = (0.25, 0.25, 0.25)) -> None:
        super().__init__()
        self.embedding, self.attention = embedding, SpatialAttention(dim)
        self.read = nn.Sequential(nn.Linear(2 * dim + 2, 128), nn.SiLU(), nn.Linear(128, N_SIGHTING + embedding))
        self.register_buffer("pixel_mean", torch.tensor(mean).view(-1, 1, 1), persistent=False)
        self.register_buffer("pixel_std", torch.tensor(std).view(-1, 1, 1), persistent=False)

    def standardise(self, images: Tensor) -> Tensor:
        """Map images in [0, 1], shape ``(F, C, H, W)``, to the range that the weights expect."""
        return (images - self.pixel_mean) / self.pixel_std

    def load_pretrained(self) -> None:
        """Load the weights that the options name; called when training starts, not when a checkpoint is opened."""

    def cells(self, images: Tensor, texts: list[str] | None) -> Tensor:
        """Return features ``(F, h, w, D)`` of images ``(F, 3, H, W)`` in [0, 1]."""
        raise NotImplementedError

    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """Return sightings, then what describes them, ``(F, 5 + embedding)``.

        Args:
            images: RGB in [0, 1], ``(F, 3, H, W)``; ``(F, 6, H, W)`` with the image before if it ``sees_motion``.
            texts: F instructions, for encoders that read them.
        """
        return self.look(images, texts)[0]

    def look(self, images: Tensor, texts: list[str] | None = None) -> tuple[Tensor, Tensor]:
        """Return what `forward` does, and the logarithm of the attention, ``(F, h, w)``."""
        cells = self.cells(images, texts)
        ray, there, heat = self.attention(cells)
        read = self.read(torch.cat([there, reduce(cells, "f h w d -> f d", "mean"), ray], dim=-1))
        return self._sighting(images, ray, read, 2 / cells.shape[2]), heat

    def _sighting(self, images: Tensor, ray: Tensor, read: Tensor, shift_unit: float) -> Tensor:
        shift, log_depth, scales, embedding = read.split([2, 1, 2, self.embedding], dim=-1)
        scales = torch.where(images[:, :3].amax((1, 2, 3))[:, None] > 0, scales, UNSEEN_SCALE)
        return torch.cat([ray + shift_unit * shift, log_depth, scales, embedding], dim=-1)


SHIPPED = {name: Path(__file__).with_name(f"eye_{name}.safetensors") for name in ("ego_96", "side_96")}
"""The eyes that come with the package, by view and side of the images that they have learned from [px]."""
PIXEL_MEAN, PIXEL_STD = (0.5, 0.5, 0.5, 0.25, 0.0, 0.0, 0.0), (0.25, 0.25, 0.25, 0.25, 0.1, 0.1, 0.1)
"""Of RGB, saturation, and the change of RGB since the image before."""


class Eye(Encoder):
    """Glance and fovea.

    Args:
        embedding: see `Encoder`.
        channels: channels of the glance at 1/4 resolution, a multiple of 8; twice as many at 1/8.
        fovea: side of the fovea [px].
        weights: safetensors file to start from, as `dynahoi pretrain` writes it, or the name of one that ships, see
            `SHIPPED`; empty for random weights.
    """

    sees_motion = True

    def __init__(self, embedding: int = 0, *, channels: int = 32, fovea: int = 20, weights: str = "") -> None:
        super().__init__(channels, embedding, PIXEL_MEAN, PIXEL_STD)
        self.weights, self.fovea = weights, fovea
        self.patches, self.refine = StandardisedPatches(len(PIXEL_MEAN), channels), conv(channels, channels)
        self.deep = nn.Sequential(conv(channels, 2 * channels, stride=2), conv(2 * channels, 2 * channels))
        self.lateral = nn.Conv2d(2 * channels, channels, kernel_size=1)
        self.merge = conv(channels, channels)
        self.foveal = nn.Sequential(
            conv(len(PIXEL_MEAN), 16), conv(16, 32, stride=2), conv(32, 64, stride=2), nn.Flatten(),
            nn.Linear(64 * math.ceil(fovea / 4) ** 2, 128), nn.SiLU(),
        )  # fmt: skip
        self.read = nn.Sequential(
            nn.Linear(128 + 3 * channels + 2, 128), nn.SiLU(), nn.Linear(128, N_SIGHTING + embedding)
        )

    def load_pretrained(self) -> None:
        """Load ``weights``.

        Raises:
            FileNotFoundError: if there is no such file.
        """
        if self.weights:
            self.load_state_dict(load_file(SHIPPED.get(self.weights, self.weights)))

    def look(self, images: Tensor, texts: list[str] | None = None) -> tuple[Tensor, Tensor]:
        """See `Encoder.look`."""
        now, before = images[:, :3], images[:, -3:]
        pixels = torch.cat([now, saturation(now), now - before], dim=1).contiguous(memory_format=torch.channels_last)
        fine = self.refine(self.patches(pixels, self.pixel_mean, self.pixel_std))  # (F, C, H/4, W/4)
        deep = self.deep(fine)
        fine = self.merge(fine + F.interpolate(self.lateral(deep), size=fine.shape[-2:]))
        ray, there, heat = self.attention(rearrange(fine, "f c h w -> f h w c"))
        seen = self.foveal(self._crop(pixels, ray.detach()))
        read = self.read(torch.cat([seen, there, reduce(deep, "f c h w -> f c", "mean"), ray], dim=-1))
        return self._sighting(images, ray, read, self.fovea / images.shape[-1]), heat

    def _crop(self, pixels: Tensor, ray: Tensor) -> Tensor:
        """Cut squares of ``fovea`` pixels around rays ``(F, 2)``, standardised."""
        steps = torch.linspace(-1, 1, self.fovea, device=pixels.device) * (self.fovea - 1)
        height, width = pixels.shape[-2:]
        x, y = ray[:, :1] + steps / width, -ray[:, 1:] + steps / height  # (F, fovea) each, in image coordinates
        grid = torch.stack(torch.broadcast_tensors(x[:, None, :], y[:, :, None]), dim=-1)
        return self.standardise(F.grid_sample(pixels, grid, padding_mode="border", align_corners=False))


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

    def cells(self, images: Tensor, texts: list[str] | None) -> Tensor:
        """See `Encoder.cells`; 1/8 resolution."""
        return rearrange(self.net(self.standardise(images)), "f c h w -> f h w c")


class ResNet18(Encoder):
    """ResNet-18 (He et al., 2016) from torchvision, at 1/16 resolution.

    Args:
        embedding: see `Encoder`.
        weights: name of torchvision's weights to start from; empty for random ones.
    """

    def __init__(self, embedding: int = 64, *, weights: str = "IMAGENET1K_V1") -> None:
        from torchvision.models import ResNet, get_model
        from torchvision.ops import FrozenBatchNorm2d

        super().__init__(256, embedding, mean=(0.485, 0.456, 0.406), std=(0.229, 0.224, 0.225))
        self.weights = weights
        # the statistics of few, correlated frames are unreliable: ImageNet's frozen ones, or normalisation by groups
        norm = FrozenBatchNorm2d if weights else lambda channels: nn.GroupNorm(channels // 16, channels)
        self.net = cast(ResNet, get_model("resnet18", weights=None, norm_layer=norm))
        del self.net.layer4, self.net.fc

    def load_pretrained(self) -> None:
        """Load torchvision's weights."""
        from torchvision.models import get_model_weights

        if self.weights:
            state = get_model_weights("resnet18")[self.weights].get_state_dict(progress=False)
            self.net.load_state_dict(state, strict=False)

    def cells(self, images: Tensor, texts: list[str] | None) -> Tensor:
        """See `Encoder.cells`."""
        net = self.net
        x = net.maxpool(net.relu(net.bn1(net.conv1(self.standardise(images)))))
        return rearrange(net.layer3(net.layer2(net.layer1(x))), "f c h w -> f h w c")


class TransformersVision(Encoder):
    """Any vision tower of ``transformers`` (SigLIP, DINOv2, CLIP, ViT, ConvNeXt, ...).

    Args:
        embedding: see `Encoder`.
        name: Hub name or folder; its ``config.json`` is needed whenever the policy is opened, its weights only when
            training starts.
        pretrained: whether training starts from its weights.
    """

    def __init__(self, embedding: int = 64, *, name: str = "facebook/dinov2-small", pretrained: bool = True) -> None:
        from transformers import AutoConfig, AutoModel, ImageProcessingMixin

        settings, _ = ImageProcessingMixin.get_image_processor_dict(name)
        config = AutoConfig.from_pretrained(name)
        vision = getattr(config, "vision_config", config)
        super().__init__(
            getattr(vision, "hidden_sizes", [vision.hidden_size])[-1],
            embedding,
            settings["image_mean"],
            settings["image_std"],
        )
        self.name, self.pretrained, self.input_px = name, pretrained, getattr(vision, "image_size", None)
        self.tower = _vision_part(AutoModel.from_config(config))

    def load_pretrained(self) -> None:
        """Load the tower's published weights."""
        from transformers import AutoModel

        if self.pretrained:
            self.tower.load_state_dict(_vision_part(AutoModel.from_pretrained(self.name)).state_dict())

    def cells(self, images: Tensor, texts: list[str] | None) -> Tensor:
        """See `Encoder.cells`; class tokens are left out."""
        if self.input_px:
            images = F.interpolate(images, (self.input_px,) * 2, mode="bilinear", align_corners=False)
        features = self.tower(pixel_values=self.standardise(images)).last_hidden_state
        if features.dim() == 4:
            return rearrange(features, "f d h w -> f h w d")
        return as_grid(features)


class SmolVLM2(Encoder):
    """SmolVLM2 (Marafioti et al., 2025): image and instruction are encoded jointly, as in the paper's backbone.

    The cells are the image tokens of the language model's last layer; the last word's token is added to each, so that
    the instruction decides where to look.

    Args:
        embedding: see `Encoder`.
        name: Hub name or folder; its config and tokenizer are needed whenever the policy is opened, its weights only
            when training starts.
        pretrained: whether training starts from its weights.
        n_layers: layers of the language model that are kept; early layers serve control best (SmolVLA).
        max_text_tokens: length at which instructions are truncated.
    """

    reads_text = True

    def __init__(
        self,
        embedding: int = 64,
        *,
        name: str = "HuggingFaceTB/SmolVLM2-500M-Video-Instruct",
        pretrained: bool = True,
        n_layers: int = 16,
        max_text_tokens: int = 48,
    ) -> None:
        from transformers import AutoConfig, AutoTokenizer, SmolVLMModel

        config: Any = AutoConfig.from_pretrained(name)
        config.text_config.num_hidden_layers = min(n_layers, config.text_config.num_hidden_layers)
        super().__init__(config.text_config.hidden_size, embedding, mean=(0.5, 0.5, 0.5), std=(0.5, 0.5, 0.5))
        self.name, self.pretrained, self.max_text_tokens = name, pretrained, max_text_tokens
        self.input_px = config.vision_config.image_size
        self.vlm, self.tokenizer = SmolVLMModel(config), AutoTokenizer.from_pretrained(name)

    def load_pretrained(self) -> None:
        """Load the published weights of the layers that are kept."""
        from transformers import SmolVLMModel

        if self.pretrained:
            full = SmolVLMModel.from_pretrained(self.name, dtype=torch.float32).state_dict()
            own = self.vlm.state_dict().keys()
            self.vlm.load_state_dict({key: value for key, value in full.items() if key in own})

    def cells(self, images: Tensor, texts: list[str] | None) -> Tensor:
        """See `Encoder.cells`."""
        images = F.interpolate(images, (self.input_px,) * 2, mode="bilinear", align_corners=False)
        features = self.vlm.vision_model(pixel_values=self.standardise(images)).last_hidden_state
        image_tokens = self.vlm.connector(features)  # (F, P, C)
        ids, lengths = self._tokenize(texts or [""] * len(images))
        words = self.vlm.text_model.embed_tokens(ids.to(images.device))
        hidden = self.vlm.text_model(
            inputs_embeds=torch.cat([image_tokens, words], dim=1), use_cache=False
        ).last_hidden_state  # (F, P + L, C)
        # attention is causal: the last word sees the image and all words, and nothing attends to the padding after it
        n_patches = image_tokens.shape[1]
        text = hidden[torch.arange(len(ids)), n_patches + lengths - 1]
        return as_grid(hidden[:, :n_patches] + text[:, None])

    def _tokenize(self, texts: list[str]) -> tuple[Tensor, Tensor]:
        """Return token ids, padded at the end, ``(F, L)``, and how many of them are words, ``(F,)``."""
        limits = {"truncation": True, "max_length": self.max_text_tokens}
        known = {text: torch.tensor(self.tokenizer(text or " ", **limits).input_ids) for text in set(texts)}
        rows = [known[text] for text in texts]
        return nn.utils.rnn.pad_sequence(rows, batch_first=True), torch.tensor([len(row) for row in rows])


ENCODERS: dict[str, type[Encoder]] = {
    "eye": Eye, "conv": Conv, "resnet18": ResNet18, "transformers": TransformersVision, "smolvlm2": SmolVLM2,
}  # fmt: skip


class StandardisedPatches(nn.Conv2d):
    """Patch embedding: a 4 x 4 convolution of stride 4, with the standardisation of the pixels folded into its weights.

    Args:
        n_in: input channels.
        n_out: output channels.
    """

    def __init__(self, n_in: int, n_out: int) -> None:
        super().__init__(n_in, n_out, kernel_size=4, stride=4)

    def forward(self, images: Tensor, mean: Tensor, std: Tensor) -> Tensor:
        """Convolve ``(images - mean) / std``, of shapes ``(F, C, H, W)`` and ``(C, 1, 1)``."""
        weight = self.weight / std  # (C', C, 4, 4)
        shift = reduce(weight * mean, "o i y x -> o", "sum")
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


def as_grid(tokens: Tensor) -> Tensor:
    """Return patch tokens as a square grid, ``(F, P + n * n, D) -> (F, n, n, D)``, without the P tokens before them."""
    side = math.isqrt(tokens.shape[1])
    return rearrange(tokens[:, tokens.shape[1] - side**2 :], "f (h w) d -> f h w d", h=side)


def _vision_part(model: nn.Module) -> nn.Module:
    """Return the image side of a model that also reads text, or the model."""
    return getattr(model, "vision_model", model)
