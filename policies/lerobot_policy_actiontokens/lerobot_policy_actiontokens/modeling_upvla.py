"""UP-VLA-style policy: a future image and a chunk of actions from an image and an instruction, in
one pass.
"""

from typing import Any, Self, cast

import torch
from diffusers.models.autoencoders.vq_model import VQModel
from lerobot.utils.constants import ACTION
from torch import Tensor, nn
from transformers import AutoModelForCausalLM, AutoTokenizer

from .chunks import ChunkPolicy, instructions, open_model, unpadded
from .configuration_upvla import UPVLAConfig

START_OF_TASK, START_OF_IMAGE, END_OF_IMAGE, ACT, FIRST_CODE = range(5)
"""Token ids, counted from the end of the language model's own words: four markers, then the image
codes."""


class UPVLAPolicy(ChunkPolicy):
    """A language model that jointly predicts a future image and a chunk of actions (UP-VLA, Zhang
    et al., 2025).

    Args:
        config: the policy's config, with its features filled in.
        **kwargs: what else LeRobot may pass, unused.
    """

    config_class = UPVLAConfig
    name = "upvla"
    config: UPVLAConfig

    def __init__(self, config: UPVLAConfig, **kwargs: Any) -> None:
        super().__init__(config)
        self.images = ImageCodes(_image_tokenizer(config), config.image_size)
        self.llm = open_model(AutoModelForCausalLM, config.llm_name, config)
        self.n_words = self.llm.get_input_embeddings().num_embeddings
        size = self.n_words + FIRST_CODE + self.images.n_codes
        self.llm.resize_token_embeddings(
            size, mean_resizing=False
        )  # random: equal codes would stay equal
        self.tokenizer = AutoTokenizer.from_pretrained(config.llm_name, padding_side="left")
        self.tokenizer.pad_token = self.tokenizer.pad_token or self.tokenizer.eos_token
        width = self.llm.config.hidden_size
        self.pooling = AttentionPooling(width, config.n_heads)
        self.to_actions = nn.Linear(width, config.chunk_size * config.action_dim)

    def forward(
        self, batch: dict[str, Any], reduction: str = "mean"
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the weighted sum of the image's cross-entropy and the actions' squared error.

        Args:
            batch: preprocessed LeRobot batch; the image has a second frame, the one to predict.
            reduction: "mean" for a scalar, "none" for one loss per sample, shape ``(B,)``.
        """
        current, future = batch[self.camera].unbind(1)  # (B, 3, H, W) each
        logits, actions = self._run(current, batch)
        codes = self.images.encode(future) + self.n_words + FIRST_CODE  # (B, N)
        prediction = nn.functional.cross_entropy(
            logits.transpose(1, 2).float(), codes, reduction="none"
        ).mean(1)
        prediction = (
            prediction * unpadded(batch, self.camera, future.new_ones(len(future), 2))[:, 1]
        )  # (B,)
        errors = (actions - batch[ACTION].reshape(actions.shape)).square().mean(2)  # (B, H)
        action = (errors * unpadded(batch, ACTION, errors)).mean(1)  # (B,)
        losses = self.config.prediction_weight * prediction + self.config.action_weight * action
        parts = {"prediction_loss": prediction.mean().item(), "action_loss": action.mean().item()}
        return (losses if reduction == "none" else losses.mean()), parts

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Return a chunk, normalized, shape ``(B, H, A)``."""
        self.eval()
        return self._run(batch[self.camera], batch)[1]

    @torch.no_grad()
    def predict_image(self, batch: dict[str, Any]) -> Tensor:
        """Return the image predicted ``chunk_size`` frames ahead, ``(B, 3, S, S)`` in [0, 1]."""
        self.eval()
        logits, _ = self._run(batch[self.camera], batch)
        return self.images.decode(logits[..., self.n_words + FIRST_CODE :].argmax(-1))

    def _run(self, images: Tensor, batch: dict[str, Any]) -> tuple[Tensor, Tensor]:
        """Return the logits of the codes of the future image ``(B, N, V)``, and the actions ``(B,
        H, A)``.
        """
        begin = self.tokenizer.bos_token or ""
        end = self.tokenizer.eos_token
        texts = [begin + task + end for task in instructions(batch, len(images))]
        words = self.tokenizer(texts, padding=True, return_tensors="pt").to(images.device)
        codes = self.images.encode(images)
        ids, mask, positions, in_image, in_actions = lay_out(
            words["input_ids"], words["attention_mask"], codes, self.config.chunk_size, self.n_words
        )
        hidden = self.llm.base_model(
            ids,
            attention_mask=torch.where(mask, 0.0, torch.finfo(self.llm.dtype).min).to(
                self.llm.dtype
            ),
            position_ids=positions,
        ).last_hidden_state  # (B, L, D)
        actions = self.to_actions(self.pooling(hidden[:, in_actions].float()))  # (B, H * A)
        logits = self.llm.get_output_embeddings()(hidden[:, in_image])
        return logits, actions.unflatten(1, (self.config.chunk_size, -1))


def lay_out(
    words: Tensor, kept: Tensor, codes: Tensor, n_actions: int, n_words: int
) -> tuple[Tensor, Tensor, Tensor, slice, slice]:
    """Return the sequence [task, words, image, codes, end of image, actions] (UP-VLA, Section 3).

    Attention of words and actions is causal; that of the image is bidirectional over the whole
    sequence. The output at each code predicts the code at the same place of the future image.

    Args:
        words: token ids of the instruction, ``(B, W)`` int64, padded on the left.
        kept: ``(B, W)``, 0 where there is padding.
        codes: image codes, ``(B, N)`` int64.
        n_actions: number of action placeholders.
        n_words: rows of the language model's original embeddings.

    Returns:
        Token ids ``(B, L)`` int64; attention mask ``(B, 1, queries, keys)`` bool, True where a
        query attends to a key; position ids ``(B, L)`` int64, counted without padding; and where
        the image codes and the placeholders are.
    """
    n, (width, n_codes) = len(words), (words.shape[1], codes.shape[1])
    mark = torch.full_like(words[:, :1], n_words)
    parts = [
        mark + START_OF_TASK,
        words,
        mark + START_OF_IMAGE,
        codes + n_words + FIRST_CODE,
        mark + END_OF_IMAGE,
        (mark + ACT).expand(n, n_actions),
    ]
    ids = torch.cat(parts, dim=1)  # (B, L)
    length = ids.shape[1]
    image = slice(width + 1, width + n_codes + 3)
    real = torch.ones_like(ids, dtype=torch.bool)
    real[:, 1 : width + 1] = kept.bool()
    mask = torch.ones(length, length, dtype=torch.bool, device=ids.device).tril()
    mask[image] = True
    mask = mask & real.unsqueeze(1) | torch.eye(length, dtype=torch.bool, device=ids.device)
    in_image = slice(image.start + 1, image.stop - 1)
    in_actions = slice(length - n_actions, length)
    return ids, mask.unsqueeze(1), real.cumsum(1) - 1, in_image, in_actions


def _image_tokenizer(config: UPVLAConfig) -> VQModel:
    name = config.image_tokenizer
    folder = config.image_tokenizer_folder or None
    if config.load_weights:
        return VQModel.from_pretrained(name, subfolder=folder)
    return cast(
        VQModel, VQModel.from_config(cast(dict, VQModel.load_config(name, subfolder=folder)))
    )


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

    def train(self, mode: bool = True) -> Self:
        """Stay in evaluation mode, whatever ``mode`` is."""
        return super().train(False)

    @torch.no_grad()
    def encode(self, images: Tensor) -> Tensor:
        """Encode images ``(B, 3, H, W)`` in [0, 1] as codes ``(B, side * side)`` int64, row by
        row.
        """
        size = (self.image_size, self.image_size)
        images = nn.functional.interpolate(images, size, mode="bicubic", antialias=True).clamp(0, 1)
        latents = self.model.encode(images.to(self.model.dtype)).latents
        return self.model.quantize(latents)[2][2].reshape(len(images), -1)

    @torch.no_grad()
    def decode(self, codes: Tensor) -> Tensor:
        """Decode codes ``(B, side * side)`` to images ``(B, 3, image_size, image_size)`` in [0,
        1].
        """
        entries = self.model.quantize.embedding(codes)  # (B, side * side, C)
        latents = entries.transpose(1, 2).unflatten(2, (self.side, self.side))
        spatial = latents if self.model.config["norm_type"] == "spatial" else None
        return self.model.decoder(self.model.post_quant_conv(latents), spatial).clamp(0, 1)


class AttentionPooling(nn.Module):
    """Many tokens to one vector: a learned query attends to all (Lee et al., 2019, Set
    Transformer), then a gated feed-forward layer (Shazeer, 2020).

    Args:
        width: size of the tokens.
        n_heads: attention heads.
    """

    def __init__(self, width: int, n_heads: int) -> None:
        super().__init__()
        self.query = nn.Parameter(0.02 * torch.randn(1, 1, width))
        self.attention = nn.MultiheadAttention(width, n_heads, batch_first=True)
        self.attention_norm = nn.RMSNorm(width)
        self.mlp_norm = nn.RMSNorm(width)
        self.gated = nn.Linear(width, 8 * width)
        self.out = nn.Linear(4 * width, width)

    def forward(self, tokens: Tensor) -> Tensor:
        """Map tokens ``(B, N, width)`` to a vector ``(B, width)``."""
        query = self.query.expand(len(tokens), -1, -1)
        pooled = self.attention_norm(
            query + self.attention(query, tokens, tokens, need_weights=False)[0]
        )
        return self.mlp_norm(pooled + self.out(nn.functional.glu(self.gated(pooled))))[:, 0]
