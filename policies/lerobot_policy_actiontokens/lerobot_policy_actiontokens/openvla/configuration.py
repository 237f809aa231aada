"""Configuration of OpenVLA's checkpoints for `transformers`."""

from __future__ import annotations

import re
from typing import Any, ClassVar, cast

from transformers import CONFIG_MAPPING, AutoConfig, PreTrainedConfig


class OpenVLAConfig(PreTrainedConfig):
    """One or two vision towers of `timm`, a projector and a language model (OpenVLA, Section 3.1).

    Attributes:
        timm_model_ids: names of the vision towers in `timm`.
        timm_override_act_layers: activation of each tower; None uses the tower's default.
        image_sizes: side of the square input image of each tower [px].
        image_seq_length: patches of an image; by default derived from the first tower's name.
        use_fused_vision_backbone: whether there are two towers, whose features are concatenated per patch.
        text_config: config of the language model.
        pad_to_multiple_of: rows without a token at the end of the embeddings.
        n_action_bins: edges of the bins of an action.
        norm_stats: ``{dataset: {"action": {"q01": [...], "q99": [...], "mask": [...]}}}``, the
            statistics by which actions were normalised in training.
    """

    model_type = "openvla"
    sub_configs: ClassVar[dict[str, Any]] = {"text_config": AutoConfig}

    timm_model_ids: list[str] | None = None
    timm_override_act_layers: list[str | None] | None = None
    image_sizes: list[int] | None = None
    image_seq_length: int | None = None
    use_fused_vision_backbone: bool = True
    text_config: dict[str, Any] | PreTrainedConfig | None = None
    pad_to_multiple_of: int = 64
    n_action_bins: int = 256
    norm_stats: dict[str, Any] | None = None
    tie_word_embeddings: bool = False

    def __post_init__(self, **kwargs: Any) -> None:
        self.timm_model_ids = self.timm_model_ids or [
            "vit_large_patch14_reg4_dinov2.lvd142m",
            "vit_so400m_patch14_siglip_224",
        ]
        self.timm_override_act_layers = self.timm_override_act_layers or [None for _ in self.timm_model_ids]
        self.image_sizes = self.image_sizes or [224] * len(self.timm_model_ids)
        if self.image_seq_length is None:
            self.image_seq_length = _patches(self.timm_model_ids[0], self.image_sizes[0])
        text = self.text_config or {}
        if isinstance(text, dict):
            self.text_config = CONFIG_MAPPING[text.get("model_type", "llama")](**text)
        super().__post_init__(**kwargs)

    @property
    def vocabulary(self) -> int:
        """Number of tokens of the tokenizer; action ids count down from it."""
        return cast(Any, self.text_config).vocab_size - self.pad_to_multiple_of

    @property
    def image_token_id(self) -> int:
        """Id of the placeholder of an image patch, which no text contains."""
        return cast(Any, self.text_config).vocab_size - 1


def _patches(tower: str, size: int) -> int:
    """Return the number of patches of a ``size`` x ``size`` px image, from the name of a tower of `timm`."""
    patch = re.search(r"patch(\d+)", tower)
    if patch is None:
        raise ValueError(
            f"the vision tower is {tower!r}, a name without 'patch<size>': set image_seq_length in the config."
        )
    return (size // int(patch[1])) ** 2
