"""OpenVLA-style policy: autoregressive action tokens from an image and an instruction."""

from typing import Any

import torch
from lerobot.utils.constants import ACTION
from torch import Tensor, nn
from transformers import AutoModelForImageTextToText, AutoProcessor

from .chunks import ChunkPolicy, instructions, open_model, unpadded
from .configuration_actiontokens import ActionTokensConfig

PROMPT = "{image}In: What action should the robot take to {instruction}?\nOut: "
VISION = ("vision_model", "vision_tower", "vision_backbone", "visual")
"""Names of the vision tower in models of `transformers`."""
N_BINS = 256
"""Actions in [-1, 1] are discretized into tokens, the last ids of the vocabulary (OpenVLA, Section
3.2)."""


class ActionTokensPolicy(ChunkPolicy):
    """A vision-language model that predicts each action dimension as one of 256 tokens (OpenVLA,
    Section 3).

    Args:
        config: the policy's config, with its features filled in.
        **kwargs: what else LeRobot may pass, unused.

    Raises:
        ValueError: if the vocabulary is too small to reuse 256 of its tokens for actions.
    """

    config_class = ActionTokensConfig
    name = "actiontokens"
    config: ActionTokensConfig

    def __init__(self, config: ActionTokensConfig, **kwargs: Any) -> None:
        super().__init__(config)
        self.vlm = open_model(AutoModelForImageTextToText, config.vlm_name, config)
        self.processor = AutoProcessor.from_pretrained(config.vlm_name)
        self.processor.tokenizer.padding_side = "left"  # actions follow the prompt without a gap
        self.vocabulary = self.processor.tokenizer.vocab_size
        if self.vocabulary <= N_BINS:
            raise ValueError(
                f"{config.vlm_name} has {self.vocabulary} tokens, but must have more than {N_BINS}."
            )
        if config.freeze_vision:
            towers = (module for name, module in self.vlm.named_modules() if name.endswith(VISION))
            next(towers).requires_grad_(False)

    def forward(
        self, batch: dict[str, Any], reduction: str = "mean"
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the cross-entropy of the action tokens.

        Args:
            batch: preprocessed LeRobot batch.
            reduction: "mean" for a scalar, "none" for one loss per sample, shape ``(B,)``.
        """
        prompt = self._prompt(batch)
        actions = batch[ACTION].reshape(len(batch[ACTION]), self.config.chunk_size, -1)  # (B, H, A)
        action_ids = encode(actions, self.vocabulary).flatten(1)  # (B, H*A)
        mask = torch.cat([prompt["attention_mask"], torch.ones_like(action_ids)], dim=1)
        inputs = {
            **prompt,
            "input_ids": torch.cat([prompt["input_ids"], action_ids], dim=1),
            "attention_mask": mask,
        }
        logits = self.vlm(**inputs, position_ids=(mask.cumsum(1) - 1).clamp_min(0)).logits
        logits = logits[
            :, -action_ids.shape[1] - 1 : -1
        ].float()  # (B, H*A, V): each position predicts the next token
        losses = nn.functional.cross_entropy(
            logits.transpose(1, 2), action_ids, reduction="none"
        )  # (B, H*A)
        kept = unpadded(batch, ACTION, actions[..., 0]).repeat_interleave(
            actions.shape[2], dim=1
        )  # (B, H*A)
        losses = (losses * kept).mean(1)  # (B,)
        return (losses if reduction == "none" else losses.mean()), {}

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Return a chunk, normalized, shape ``(B, H, A)``, by greedy decoding constrained to action
        tokens.
        """
        self.eval()
        size = self.config.action_dim
        count = self.config.chunk_size * size
        allowed = list(range(self.vocabulary - N_BINS, self.vocabulary))
        action_ids = self.vlm.generate(
            **self._prompt(batch),
            min_new_tokens=count,
            max_new_tokens=count,
            do_sample=False,
            prefix_allowed_tokens_fn=lambda row, ids: allowed,
        )[:, -count:]
        return decode(action_ids, self.vocabulary).reshape(len(action_ids), -1, size)

    def _prompt(self, batch: dict[str, Any]) -> dict[str, Tensor]:
        """Return the processed inputs of the model: one image and one instruction per sample."""
        images = batch[self.camera]  # (B, 3, H, W) in [0, 1]
        images_uint8 = [
            [image] for image in (images.clamp(0, 1) * 255).round().to(torch.uint8).cpu()
        ]
        token = str(getattr(self.processor, "image_token", "<image>"))
        texts = [
            PROMPT.format(image=token, instruction=task.rstrip(".").lower())
            for task in instructions(batch, len(images))
        ]
        inputs = self.processor(images=images_uint8, text=texts, padding=True, return_tensors="pt")
        inputs["pixel_values"] = inputs["pixel_values"].to(self.vlm.dtype)
        return {key: value.to(images.device) for key, value in inputs.items()}


def encode(values: Tensor, vocabulary: int) -> Tensor:
    """Return the token id of each value; values outside [-1, 1] are clipped.

    Args:
        values: normalized actions, any shape.
        vocabulary: number of tokens of the tokenizer; the ids count down from it.
    """
    return vocabulary - torch.bucketize(
        values.float().clamp(-1, 1), _edges(values.device), right=True
    )


def decode(ids: Tensor, vocabulary: int) -> Tensor:
    """Return the center of the bin of each id, in [-1, 1].

    Args:
        ids: token ids, any shape.
        vocabulary: number of tokens of the tokenizer.
    """
    edges = _edges(ids.device)
    centers = (edges[:-1] + edges[1:]) / 2
    return centers[(vocabulary - ids - 1).clamp(0, N_BINS - 2)]


def _edges(device: torch.device) -> Tensor:
    return torch.linspace(-1, 1, N_BINS, device=device)
