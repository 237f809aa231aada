"""SmolVLM2 (Marafioti et al., 2025): image and instruction are encoded jointly by a small vision-language model."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .base import Backbone, backbones
from .transformers_vision import pool_patches


@backbones.register("smolvlm2")
class SmolVLM2Backbone(Backbone):
    """Image tokens and one text token from the last hidden layer of the language model over ``[image, instruction]``.

    Args:
        width: token size.
        name: Hub name or folder; its config and tokenizer are needed whenever the policy is opened, its weights only
            when training starts.
        pretrained: whether training starts from its weights.
        freeze: whether its weights are excluded from training.
        n_layers: layers of the language model that are kept; early layers serve control best (SmolVLA).
        grid: side of the grid to which image tokens are pooled at the end.
        max_text_tokens: length at which instructions are truncated [tokens].
    """

    reads_text = True

    def __init__(
        self,
        width: int,
        *,
        name: str = "HuggingFaceTB/SmolVLM2-500M-Video-Instruct",
        pretrained: bool = True,
        freeze: bool = True,
        n_layers: int = 16,
        grid: int = 4,
        max_text_tokens: int = 48,
    ) -> None:
        from transformers import AutoConfig, AutoTokenizer, SmolVLMModel

        super().__init__(width, mean=(0.5, 0.5, 0.5), std=(0.5, 0.5, 0.5))
        self.name, self.pretrained, self.freeze = name, pretrained, freeze
        self.grid, self.max_text_tokens = grid, max_text_tokens
        config: Any = AutoConfig.from_pretrained(name)
        config.text_config.num_hidden_layers = min(n_layers, config.text_config.num_hidden_layers)
        self.input_px = config.vision_config.image_size
        self.vlm = SmolVLMModel(config)
        self.tokenizer = AutoTokenizer.from_pretrained(name)
        self.project = nn.Linear(config.text_config.hidden_size, width)
        self.vlm.requires_grad_(not freeze)

    def load_pretrained(self) -> None:
        """Load the published weights of the layers that are kept."""
        from transformers import SmolVLMModel

        if self.pretrained:
            full = SmolVLMModel.from_pretrained(self.name, dtype=torch.float32).state_dict()
            own = self.vlm.state_dict().keys()
            self.vlm.load_state_dict({key: value for key, value in full.items() if key in own})

    def train(self, mode: bool = True) -> SmolVLM2Backbone:
        """Keep a frozen model in evaluation mode."""
        super().train(mode)
        if self.freeze:
            self.vlm.eval()
        return self

    def forward(self, images: Tensor, texts: list[str] | None = None) -> Tensor:
        """See `Backbone.forward`; ``N = grid ** 2 + 1``."""
        with torch.set_grad_enabled(torch.is_grad_enabled() and not self.freeze):
            image_tokens, text_token = self._encode(images, texts or [""] * len(images))
        return self.project(torch.cat([pool_patches(image_tokens, self.grid), text_token], dim=1))

    def _encode(self, images: Tensor, texts: list[str]) -> tuple[Tensor, Tensor]:
        """Return image tokens ``(F, P, C)`` and a text token ``(F, 1, C)`` of the language model's last layer."""
        images = F.interpolate(images, (self.input_px,) * 2, mode="bilinear", align_corners=False)
        features = self.vlm.vision_model(pixel_values=self.standardise(images)).last_hidden_state
        image_tokens = self.vlm.connector(features)  # (F, P, C)

        ids, lengths = self._tokenize(texts)  # (F, L), (F,)
        words = self.vlm.text_model.embed_tokens(ids.to(images.device))
        hidden = self.vlm.text_model(
            inputs_embeds=torch.cat([image_tokens, words], dim=1), use_cache=False
        ).last_hidden_state  # (F, P + L, C)
        # Attention is causal: image tokens come first and do not see the text, the last word sees everything, and
        # nothing attends to the padding after it.
        last_word = image_tokens.shape[1] + lengths - 1
        return hidden[:, : image_tokens.shape[1]], hidden[torch.arange(len(ids)), last_word][:, None]

    def _tokenize(self, texts: list[str]) -> tuple[Tensor, Tensor]:
        """Return token ids, padded at the end, shape ``(F, L)``, and how many of them are words, shape ``(F,)``."""
        limits = {"truncation": True, "max_length": self.max_text_tokens}
        known = {text: torch.tensor(self.tokenizer(text or " ", **limits).input_ids) for text in set(texts)}
        rows = [known[text] for text in texts]
        return nn.utils.rnn.pad_sequence(rows, batch_first=True), torch.tensor([len(row) for row in rows])
