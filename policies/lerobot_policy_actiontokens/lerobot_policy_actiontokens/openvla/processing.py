"""OpenVLA's processor: pixels for each vision tower, and a prompt with placeholders for the patches."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Self, cast

import torch
from PIL.Image import Image
from torch import Tensor
from torchvision.transforms import InterpolationMode
from torchvision.transforms import functional as tvf
from transformers import AutoConfig, AutoTokenizer
from transformers.utils.hub import cached_file

from .configuration import OpenVLAConfig

EMPTY = "▁"
"""The token between "Out:" and the first action in OpenVLA's training data."""


class PrismaticProcessor:
    """Converts images and prompts into model inputs; the class name is the one that OpenVLA's checkpoints ask for.

    Args:
        config: config of the model.
        tokenizer: tokenizer of its language model.
        image_settings: `preprocessor_config.json` of the checkpoint: ``input_sizes``, ``interpolations``, ``means`` and
            ``stds`` of every tower, and ``image_resize_strategy``.
    """

    image_token = "<image>"

    def __init__(self, config: OpenVLAConfig, tokenizer: Any, image_settings: dict[str, Any]) -> None:
        self.config = config
        self.tokenizer = tokenizer
        self.image_settings = image_settings

    @classmethod
    def from_pretrained(cls, name: str | Path, **kwargs: Any) -> Self:
        """Open a checkpoint, by folder or Hub name."""
        kwargs = {key: value for key, value in kwargs.items() if key in ("revision", "token", "cache_dir")}
        settings = json.loads(Path(str(cached_file(name, "preprocessor_config.json", **kwargs))).read_text())
        config: Any = AutoConfig.from_pretrained(name, **kwargs)
        return cls(config, AutoTokenizer.from_pretrained(name, **kwargs), settings)

    def __call__(
        self, images: list[list[Tensor]], text: list[str], padding: bool = True, return_tensors: str = "pt"
    ) -> dict[str, Tensor]:
        """Return the model's inputs.

        Args:
            images: one list per prompt, of one image ``(3, H, W)`` uint8.
            text: prompts, each of which starts with ``image_token``.
            padding: ignored: prompts are always padded, on the tokenizer's side.
            return_tensors: ignored: always "pt".

        Returns:
            ``input_ids`` and ``attention_mask``, ``(B, L)`` int64, and ``pixel_values``, ``(B, 3 per tower, H, W)``
            float32.

        Raises:
            ValueError: if an image is not square and the checkpoint does not resize naively.
        """
        del padding, return_tensors
        prompts = [self._tokens(prompt) for prompt in text]
        inputs = self.tokenizer.pad({"input_ids": prompts}, return_tensors="pt")
        pixels = torch.stack([self._pixels(image) for (image,) in images])
        return {"input_ids": inputs["input_ids"], "attention_mask": inputs["attention_mask"], "pixel_values": pixels}

    def _tokens(self, prompt: str) -> list[int]:
        """Return the ids of the patches, the prompt and the empty token, as in training."""
        words = self.tokenizer(prompt.removeprefix(self.image_token), add_special_tokens=False)["input_ids"]
        empty = self.tokenizer.get_vocab().get(EMPTY)
        ending = [] if empty is None or words[-1] == empty else [empty]
        patches = [self.config.image_token_id] * (self.config.image_seq_length or 0)
        return [self.tokenizer.bos_token_id, *patches, *words, *ending]

    def _pixels(self, image: Tensor) -> Tensor:
        """Return the normalised image of every tower, ``(3 per tower, H, W)`` float32."""
        strategy = self.image_settings["image_resize_strategy"]
        if strategy != "resize-naive" and image.shape[1] != image.shape[2]:
            raise ValueError(f"the image is {image.shape[2]} x {image.shape[1]}, but must be square for {strategy}.")
        pil_image = tvf.to_pil_image(image)
        pixels = []
        for size, interpolation, mean, std in zip(
            *(self.image_settings[key] for key in ("input_sizes", "interpolations", "means", "stds")), strict=True
        ):
            resized = tvf.resize(pil_image, size[1:], InterpolationMode(interpolation), antialias=True)
            pixels.append(tvf.normalize(tvf.to_tensor(cast(Image, resized)), mean, std))
        return torch.cat(pixels)
