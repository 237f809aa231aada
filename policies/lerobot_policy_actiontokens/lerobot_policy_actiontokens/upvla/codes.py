"""Discrete image codes from a frozen vector-quantised autoencoder."""

from __future__ import annotations

import torch
from diffusers.models.autoencoders.vq_model import VQModel
from torch import Tensor, nn


class ImageCodes(nn.Module):
    """Encodes images as codes, and decodes them, with a frozen `diffusers` ``VQModel``.

    Args:
        model: the autoencoder, of images in [0, 1].
        image_size: side of the encoded images [px]; other sizes are resized.

    Attributes:
        n_codes: size of the codebook.
        side: side of the grid of codes.
    """

    def __init__(self, model: VQModel, image_size: int) -> None:
        super().__init__()
        self.model = model.requires_grad_(False).eval()
        self.image_size = image_size
        self.n_codes = int(model.config["num_vq_embeddings"])
        self.side = image_size // 2 ** (len(model.config["block_out_channels"]) - 1)

    def train(self, mode: bool = True) -> ImageCodes:
        """Stay in evaluation mode, whatever ``mode`` is."""
        return super().train(False)

    @torch.no_grad()
    def encode(self, images: Tensor) -> Tensor:
        """Encode images ``(B, 3, H, W)`` in [0, 1] as codes ``(B, side * side)`` int64, row by row."""
        size = (self.image_size, self.image_size)
        images = nn.functional.interpolate(images, size, mode="bicubic", antialias=True).clamp(0, 1)
        latents = self.model.encode(images.to(self.model.dtype)).latents
        return self.model.quantize(latents)[2][2].reshape(len(images), -1)

    @torch.no_grad()
    def decode(self, codes: Tensor) -> Tensor:
        """Decode codes ``(B, side * side)`` to images ``(B, 3, image_size, image_size)`` in [0, 1]."""
        entries = self.model.quantize.embedding(codes)  # (B, side * side, C)
        latents = entries.transpose(1, 2).unflatten(2, (self.side, self.side))
        spatial = latents if self.model.config["norm_type"] == "spatial" else None
        return self.model.decoder(self.model.post_quant_conv(latents), spatial).clamp(0, 1)
