"""UP-VLA-style policy: a future image and a chunk of actions from an image and an instruction, in one pass."""

from __future__ import annotations

from typing import Any, cast

import torch
from diffusers.models.autoencoders.vq_model import VQModel
from lerobot.utils.constants import ACTION
from torch import Tensor, nn
from transformers import AutoModelForCausalLM, AutoTokenizer

from lerobot_policy_actiontokens.chunks import ChunkPolicy, instructions, open_model, unpadded

from .codes import ImageCodes
from .configuration_upvla import UPVLAConfig
from .pooling import AttentionPooling
from .sequence import Vocabulary, lay_out


class UPVLAPolicy(ChunkPolicy):
    """A language model that jointly predicts a future image and a chunk of actions (UP-VLA, Zhang et al., 2025).

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
        self.vocabulary = Vocabulary(self.llm.get_input_embeddings().num_embeddings, self.images.n_codes)
        self.llm.resize_token_embeddings(
            len(self.vocabulary), mean_resizing=False
        )  # random: equal codes would stay equal
        self.tokenizer = AutoTokenizer.from_pretrained(config.llm_name, padding_side="left")
        self.tokenizer.pad_token = self.tokenizer.pad_token or self.tokenizer.eos_token
        width, size = self.llm.config.hidden_size, config.action_dim
        self.pooling = AttentionPooling(width, config.n_heads)
        self.to_actions = nn.Linear(width, config.chunk_size * size)

    def forward(self, batch: dict[str, Any], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Return the weighted sum of the image's cross-entropy and the actions' squared error.

        Args:
            batch: preprocessed LeRobot batch; the image has a second frame, the one to predict.
            reduction: "mean" for a scalar, "none" for one loss per sample, shape ``(B,)``.
        """
        current, future = batch[self.camera].unbind(1)  # (B, 3, H, W) each
        logits, actions = self._run(current, batch)
        codes = self.images.encode(future) + self.vocabulary.first_code  # (B, N)
        prediction = nn.functional.cross_entropy(logits.transpose(1, 2).float(), codes, reduction="none").mean(1)
        prediction = prediction * unpadded(batch, self.camera, future.new_ones(len(future), 2))[:, 1]  # (B,)
        errors = (actions - batch[ACTION].reshape(actions.shape)).square().mean(2)  # (B, H)
        action = (errors * unpadded(batch, ACTION, errors)).mean(1)  # (B,)
        losses = self.config.prediction_weight * prediction + self.config.action_weight * action
        parts = {"prediction_loss": prediction.mean().item(), "action_loss": action.mean().item()}
        return (losses if reduction == "none" else losses.mean()), parts

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Return a chunk, normalised, shape ``(B, H, A)``."""
        self.eval()
        return self._run(batch[self.camera], batch)[1]

    @torch.no_grad()
    def predict_image(self, batch: dict[str, Any]) -> Tensor:
        """Return the image predicted ``chunk_size`` frames ahead, ``(B, 3, S, S)`` in [0, 1]."""
        self.eval()
        logits, _ = self._run(batch[self.camera], batch)
        return self.images.decode(logits[..., self.vocabulary.first_code :].argmax(-1))

    def _run(self, images: Tensor, batch: dict[str, Any]) -> tuple[Tensor, Tensor]:
        """Return the logits of the codes of the future image ``(B, N, V)``, and the actions ``(B, H, A)``."""
        begin, end = self.tokenizer.bos_token or "", self.tokenizer.eos_token
        texts = [begin + task + end for task in instructions(batch, len(images))]
        words = self.tokenizer(texts, padding=True, return_tensors="pt").to(images.device)
        codes = self.images.encode(images)
        sequence = lay_out(words["input_ids"], words["attention_mask"], codes, self.config.chunk_size, self.vocabulary)
        hidden = self.llm.base_model(
            sequence.ids,
            attention_mask=torch.where(sequence.mask, 0.0, torch.finfo(self.llm.dtype).min).to(self.llm.dtype),
            position_ids=sequence.positions,
        ).last_hidden_state  # (B, L, D)
        actions = self.to_actions(self.pooling(hidden[:, sequence.actions].float()))  # (B, H * A)
        logits = self.llm.get_output_embeddings()(hidden[:, sequence.codes])
        return logits, actions.unflatten(1, (self.config.chunk_size, -1))


def _image_tokenizer(config: UPVLAConfig) -> VQModel:
    place: dict[str, Any] = {"subfolder": config.image_tokenizer_folder} if config.image_tokenizer_folder else {}
    if config.load_weights:
        return VQModel.from_pretrained(config.image_tokenizer, **place)
    settings = cast(dict[str, Any], VQModel.load_config(config.image_tokenizer, **place))
    return cast(VQModel, VQModel.from_config(settings))
