"""Images as codes and back, by a frozen vector-quantised autoencoder."""

from __future__ import annotations

import torch
from diffusers import VQModel
from torch import Tensor, nn


class ImageCodes(nn.Module):
    """A `diffusers` ``VQModel`` that is not trained.

    Args:
        model: The autoencoder, for images in [0, 1].
        image_size: Side of the images that it sees [px]; others are scaled.

    Attributes:
        n_codes: Number of different codes.
        side: Codes on a side of the image.
    """

    def __init__(self, model: VQModel, image_size: int) -> None:
        super().__init__()
        self.model = model.requires_grad_(False).eval()
        self.image_size = image_size
        self.n_codes = int(model.config["num_vq_embeddings"])
        self.side = image_size // 2 ** (len(model.config["block_out_channels"]) - 1)

    def train(self, mode: bool = True) -> ImageCodes:
        """Stay in evaluation mode."""
        return super().train(False)

    @torch.no_grad()
    def encode(self, images: Tensor) -> Tensor:
        """Return the codes of (B, 3, H, W) images in [0, 1], (B, side * side) int64, row by row."""
        size = (self.image_size, self.image_size)
        images = nn.functional.interpolate(images, size, mode="bicubic", antialias=True).clamp(0, 1)
        latents = self.model.encode(images.to(self.model.dtype)).latents
        return self.model.quantize(latents)[2][2].reshape(len(images), -1)

    @torch.no_grad()
    def decode(self, codes: Tensor) -> Tensor:
        """Return the images, (B, 3, image_size, image_size) in [0, 1], of (B, side * side) codes."""
        entries = self.model.quantize.embedding(codes)  # (B, side * side, C)
        latents = entries.transpose(1, 2).unflatten(2, (self.side, self.side))
        spatial = latents if self.model.config["norm_type"] == "spatial" else None
        return self.model.decoder(self.model.post_quant_conv(latents), spatial).clamp(0, 1)
