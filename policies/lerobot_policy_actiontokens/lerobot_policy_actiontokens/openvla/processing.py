"""What OpenVLA reads: pictures for each of its towers, and a prompt with room for their patches."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor
from torchvision.transforms import InterpolationMode
from torchvision.transforms import functional as tvf
from transformers import AutoConfig, AutoTokenizer, PreTrainedTokenizerBase
from transformers.utils import cached_file

from .configuration import OpenVLAConfig

EMPTY = "▁"
"""The token between "Out:" and the first action in OpenVLA's training data."""


class PrismaticProcessor:
    """Images and prompts to the inputs of the model; the name is the one that OpenVLA's checkpoints ask for.

    Args:
        config: Of the model.
        tokenizer: Of its language model.
        pictures: `preprocessor_config.json` of the checkpoint: ``input_sizes``, ``interpolations``, ``means`` and
            ``stds`` of every tower, and ``image_resize_strategy``.
    """

    image_token = "<image>"

    def __init__(self, config: OpenVLAConfig, tokenizer: PreTrainedTokenizerBase, pictures: dict[str, Any]) -> None:
        self.config = config
        self.tokenizer = tokenizer
        self.pictures = pictures

    @classmethod
    def from_pretrained(cls, name: str | Path, **kwargs: Any) -> Self:
        """Open a folder or a repository of the Hub."""
        kwargs = {key: value for key, value in kwargs.items() if key in ("revision", "token", "cache_dir")}
        pictures = json.loads(Path(cached_file(name, "preprocessor_config.json", **kwargs)).read_text())
        return cls(AutoConfig.from_pretrained(name, **kwargs), AutoTokenizer.from_pretrained(name, **kwargs), pictures)

    def __call__(
        self, images: list[list[Tensor]], text: list[str], padding: bool = True, return_tensors: str = "pt"
    ) -> dict[str, Tensor]:
        """Return the model's inputs.

        Args:
            images: one for each prompt, a list of one (3, H, W) uint8.
            text: prompts, each beginning with ``image_token``.
            padding: shorter prompts are always padded, on the tokenizer's side.
            return_tensors: always "pt".

        Returns:
            ``input_ids`` and ``attention_mask``, (B, L) int64, and ``pixel_values``, (B, 3 per tower, H, W) float32.

        Raises:
            ValueError: for an image that is not square, if the checkpoint would crop or pad it.
        """
        del padding, return_tensors
        prompts = [self._tokens(prompt) for prompt in text]
        inputs = self.tokenizer.pad({"input_ids": prompts}, return_tensors="pt")
        pixels = torch.stack([self._picture(image) for (image,) in images])
        return {"input_ids": inputs["input_ids"], "attention_mask": inputs["attention_mask"], "pixel_values": pixels}

    def _tokens(self, prompt: str) -> list[int]:
        """Begin with the patches, end with the empty token, as in training."""
        words = self.tokenizer(prompt.removeprefix(self.image_token), add_special_tokens=False)["input_ids"]
        empty = self.tokenizer.get_vocab().get(EMPTY)
        ending = [] if empty is None or words[-1] == empty else [empty]
        patches = [self.config.image_token_id] * self.config.image_seq_length
        return [self.tokenizer.bos_token_id, *patches, *words, *ending]

    def _picture(self, image: Tensor) -> Tensor:
        """Return what every tower sees of an image, (3 per tower, H, W) float32."""
        strategy = self.pictures["image_resize_strategy"]
        if strategy != "resize-naive" and image.shape[1] != image.shape[2]:
            raise ValueError(f"The image is {image.shape[2]} x {image.shape[1]}, but must be square for {strategy}.")
        picture = tvf.to_pil_image(image)
        pixels = []
        for size, interpolation, mean, std in zip(
            *(self.pictures[key] for key in ("input_sizes", "interpolations", "means", "stds")), strict=True
        ):
            resized = tvf.resize(picture, size[1:], InterpolationMode(interpolation), antialias=True)
            pixels.append(tvf.normalize(tvf.to_tensor(resized), mean, std))
        return torch.cat(pixels)
