"""OpenVLA as an image-text model of `transformers`, with the parameter names of its checkpoints."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from transformers import AutoModelForCausalLM, GenerationMixin, PreTrainedModel
from transformers.modeling_outputs import CausalLMOutputWithPast

from .configuration import OpenVLAConfig


class OpenVLAForActionPrediction(PreTrainedModel, GenerationMixin):
    """A language model whose input embeddings at ``config.image_token_id`` are replaced by projected image patches.

    Args:
        config: sizes of its parts.

    Raises:
        ImportError: if `timm` is not installed.
    """

    config_class = OpenVLAConfig
    base_model_prefix = "model"
    input_modalities: ClassVar[Any] = ("image", "text")
    supports_gradient_checkpointing = True
    _supports_sdpa = True
    _supports_flash_attn = True
    _no_split_modules: ClassVar[list[str]] = ["LlamaDecoderLayer"]

    def __init__(self, config: OpenVLAConfig) -> None:
        super().__init__(config)
        self.vision_backbone = VisionBackbone(config)
        text_config: Any = config.text_config
        self.language_model = AutoModelForCausalLM.from_config(text_config)
        self.projector = Projector(
            self.vision_backbone.width, text_config.hidden_size, config.use_fused_vision_backbone
        )
        self.post_init()

    def get_input_embeddings(self) -> nn.Module:
        """Return the embeddings of the language model."""
        return self.language_model.get_input_embeddings()

    def get_output_embeddings(self) -> nn.Module:
        """Return the embeddings of the language model."""
        return self.language_model.get_output_embeddings()

    def forward(
        self,
        input_ids: Tensor | None = None,
        pixel_values: Tensor | None = None,
        attention_mask: Tensor | None = None,
        **kwargs: Any,
    ) -> CausalLMOutputWithPast:
        """Return the logits of the next tokens.

        Args:
            input_ids: ``(B, L)``, with one image token per patch if an image is given.
            pixel_values: ``(B, 3 or 6, H, W)``, the normalised images of the towers, concatenated along channels.
            attention_mask: ``(B, L)``, 0 where there is padding.
            **kwargs: other inputs of the language model: position_ids, past_key_values, labels, ...

        Raises:
            ValueError: if the towers return another number of patches than ``config.image_seq_length``.
        """
        if pixel_values is None:
            return self.language_model(input_ids=input_ids, attention_mask=attention_mask, **kwargs)
        embeddings = self.get_input_embeddings()(input_ids)  # (B, L, D)
        patches = self.projector(self.vision_backbone(pixel_values))  # (B, P, D)
        if patches.shape[1] != self.config.image_seq_length:
            raise ValueError(f"there are {patches.shape[1]} patches, but must be {self.config.image_seq_length}.")
        is_image = (input_ids == self.config.image_token_id).unsqueeze(-1)  # (B, L, 1)
        embeddings = embeddings.masked_scatter(is_image, patches.to(embeddings.dtype))
        return self.language_model(inputs_embeds=embeddings, attention_mask=attention_mask, **kwargs)

    def prepare_inputs_for_generation(
        self, *args: Any, pixel_values: Tensor | None = None, is_first_iteration: bool = False, **kwargs: Any
    ) -> dict[str, Any]:
        """Pass the image in the first step only: later steps find its keys and values in the cache."""
        parent: Any = super()
        inputs = parent.prepare_inputs_for_generation(*args, is_first_iteration=is_first_iteration, **kwargs)
        if is_first_iteration or not kwargs.get("use_cache", True):
            inputs["pixel_values"] = pixel_values
        return inputs

    def _init_weights(self, module: nn.Module) -> None:
        """Keep the initialisation of `timm` in the towers."""
        if not isinstance(module, Scale):
            super()._init_weights(module)


class VisionBackbone(nn.Module):
    """The features of the second-to-last layer of every tower, concatenated per patch.

    Args:
        config: config of the whole model.
    """

    def __init__(self, config: OpenVLAConfig) -> None:
        super().__init__()
        names, sizes = config.timm_model_ids or [], config.image_sizes or []
        activations = config.timm_override_act_layers or []
        towers = [_tower(*options) for options in zip(names, sizes, activations, strict=True)]
        self.featurizer = towers[0]
        if config.use_fused_vision_backbone:
            self.fused_featurizer = towers[1]
        self.width = sum(int(tower.embed_dim) for tower in towers)

    def forward(self, pixel_values: Tensor) -> Tensor:
        """Map pixels ``(B, 3 per tower, H, W)`` to features ``(B, P, width)``."""
        towers: list[Any] = list(self.children())
        images = pixel_values.split(3, dim=1)
        features = [
            tower.get_intermediate_layers(image, n={len(tower.blocks) - 2})[0]
            for tower, image in zip(towers, images, strict=True)
        ]
        return torch.cat(features, dim=2)


class Projector(nn.Module):
    """An MLP from features of the vision towers to embeddings of the language model.

    Args:
        vision: size of the features.
        text: size of the embeddings.
        fused: whether the features are those of two towers; the MLP then has three layers instead of two.
    """

    def __init__(self, vision: int, text: int, fused: bool) -> None:
        super().__init__()
        self.fc1 = nn.Linear(vision, 4 * vision if fused else text)
        self.fc2 = nn.Linear(4 * vision if fused else text, text)
        if fused:
            self.fc3 = nn.Linear(text, text)

    def forward(self, features: Tensor) -> Tensor:
        """Map ``(B, P, vision)`` to ``(B, P, text)``."""
        first, *others = self.children()
        features = first(features)
        for layer in others:
            features = layer(nn.functional.gelu(features))
        return features


class Scale(nn.Module):
    """`timm`'s LayerScale with the parameter name of OpenVLA's checkpoints.

    Args:
        width: number of channels.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.scale_factor = nn.Parameter(torch.ones(width))

    def forward(self, x: Tensor) -> Tensor:
        """Scale each channel, ``(..., width) -> (..., width)``."""
        return x * self.scale_factor


def _tower(name: str, size: int, activation: str | None) -> Any:
    import timm
    from timm.layers.layer_scale import LayerScale

    tower = timm.create_model(name, pretrained=False, num_classes=0, img_size=size, act_layer=activation)
    for parent in list(tower.modules()):
        for child, module in list(parent.named_children()):
            if isinstance(module, LayerScale):
                setattr(parent, child, Scale(len(module.gamma)))
    return tower
