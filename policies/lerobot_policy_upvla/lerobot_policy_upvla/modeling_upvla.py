"""The policy: an image and an instruction in, the image to come and a chunk of actions out, in one pass."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any, Self

import torch
from diffusers import VQModel
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION
from torch import Tensor, nn
from transformers import AutoConfig, AutoModelForCausalLM, AutoTokenizer

from .codes import ImageCodes
from .configuration_upvla import UPVLAConfig
from .pooling import AttentionPooling
from .sequence import Vocabulary, lay_out


class UPVLAPolicy(PreTrainedPolicy):
    """A language model that predicts what it will see and what to do (UP-VLA, Zhang et al., 2025).

    Args:
        config: The policy's config, with its features filled in.
        **kwargs: What else LeRobot may pass, unused.
    """

    config_class = UPVLAConfig
    name = "upvla"

    def __init__(self, config: UPVLAConfig, **kwargs: Any) -> None:
        super().__init__(config)
        config.validate_features()
        self.images = ImageCodes(_image_tokenizer(config), config.image_size)
        self.llm = _language_model(config)
        self.vocabulary = Vocabulary(self.llm.get_input_embeddings().num_embeddings, self.images.n_codes)
        self.llm.resize_token_embeddings(len(self.vocabulary), mean_resizing=False)  # codes differ from the start
        self.tokenizer = AutoTokenizer.from_pretrained(config.llm_name, padding_side="left")
        self.tokenizer.pad_token = self.tokenizer.pad_token or self.tokenizer.eos_token
        width, size = self.llm.config.hidden_size, config.action_feature.shape[0]
        self.pooling = AttentionPooling(width, config.n_heads)
        self.to_actions = nn.Linear(width, config.chunk_size * size)
        self.reset()

    def forward(self, batch: dict[str, Any], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Return the weighted sum of the image's cross-entropy and the actions' squared error.

        Args:
            batch: preprocessed LeRobot batch; the image has a second frame, the one to predict.
            reduction: "mean" for a scalar, "none" for one loss per sample, shape ``(B,)``.
        """
        key = self._camera()
        now, later = batch[key].unbind(1)  # (B, 3, H, W) each
        logits, actions = self._run(now, batch["task"])
        codes = self.images.encode(later) + self.vocabulary.first_code  # (B, N)
        prediction = nn.functional.cross_entropy(logits.transpose(1, 2).float(), codes, reduction="none").mean(1)
        prediction = prediction * _within(batch, key, now)[:, -1]  # (B,), no frame after the last
        target = batch[ACTION].reshape(actions.shape)  # (B, H, A)
        kept = _within(batch, ACTION, target[..., 0])
        action = ((actions - target).square().mean(2) * kept).mean(1)  # (B,)
        losses = self.config.prediction_weight * prediction + self.config.action_weight * action
        parts = {"prediction_loss": prediction.mean().item(), "action_loss": action.mean().item()}
        return (losses if reduction == "none" else losses.mean()), parts

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Return a chunk, shape ``(B, H, A)``, normalised."""
        self.eval()
        return self._run(batch[self._camera()], batch["task"])[1]

    @torch.no_grad()
    def predict_image(self, batch: dict[str, Any]) -> Tensor:
        """Return what will be seen ``chunk_size`` frames from now, ``(B, 3, S, S)`` in [0, 1]."""
        self.eval()
        logits, _ = self._run(batch[self._camera()], batch["task"])
        return self.images.decode(logits[..., self.vocabulary.first_code :].argmax(-1))

    @torch.no_grad()
    def select_action(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """Return the next action, shape ``(B, A)``, normalised; a new chunk when the last one is used up."""
        if not self._queue:
            chunk = self.predict_action_chunk(batch)[:, : self.config.n_action_steps]
            self._queue.extend(chunk.transpose(0, 1))
        return self._queue.popleft()

    def reset(self) -> None:
        """Forget the last episode."""
        self._queue: deque[Tensor] = deque()

    def get_optim_params(self) -> list[Tensor]:
        """Return what is trained: all but the image's tokenizer."""
        return [p for p in self.parameters() if p.requires_grad]

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Open a checkpoint, which carries its own weights."""
        config = kwargs.pop("config", None) or UPVLAConfig.from_pretrained(pretrained_name_or_path)
        config.load_weights = False
        return super().from_pretrained(pretrained_name_or_path, config=config, **kwargs)

    def _run(self, images: Tensor, task: str | list[str]) -> tuple[Tensor, Tensor]:
        """Return (B, N, V) logits of the image to come and (B, H, A) actions."""
        tasks = [task] * len(images) if isinstance(task, str) else task
        words = self.tokenizer([text + self.tokenizer.eos_token for text in tasks], padding=True, return_tensors="pt")
        words = words.to(images.device)
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

    def _camera(self) -> str:
        return next(iter(self.config.image_features))


def _language_model(config: UPVLAConfig) -> Any:
    dtype = getattr(torch, config.dtype)
    if config.load_weights:
        return AutoModelForCausalLM.from_pretrained(config.llm_name, dtype=dtype)
    return AutoModelForCausalLM.from_config(AutoConfig.from_pretrained(config.llm_name), dtype=dtype)


def _image_tokenizer(config: UPVLAConfig) -> VQModel:
    place = {"subfolder": config.image_tokenizer_folder} if config.image_tokenizer_folder else {}
    if config.load_weights:
        return VQModel.from_pretrained(config.image_tokenizer, **place)
    return VQModel.from_config(VQModel.load_config(config.image_tokenizer, **place))


def _within(batch: dict[str, Any], key: str, like: Tensor) -> Tensor:
    """(B, T) 1 for frames of ``key`` that are within the episode."""
    pad = batch.get(f"{key}_is_pad")
    return like.new_ones(len(like), 1) if pad is None else (~pad.bool()).to(like.dtype)
